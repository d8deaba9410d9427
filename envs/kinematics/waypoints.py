"""Waypoints of a gripper, and minimum-jerk paths through them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np


@dataclass(frozen=True, kw_only=True, slots=True)
class Waypoint:
    """A pose of the gripper and the time to reach it.

    Attributes:
        pos: End effector position in the world, m, (3,).
        yaw: Turn of the gripper about world z from its rest posture, in which it points down, rad.
        gripper: Distance of each fingertip from the middle, m; a robot maps it to its gripper's joints.
        duration_s: Time to come here from the last waypoint.
        hold_s: Time to wait here.
        pitch: Turn about y, before the yaw, rad; positive tips the fingers backwards, towards -x.
        roll: Turn about x, before the pitch, rad; positive tips the fingers towards +y.
    """

    pos: np.ndarray = field(repr=False)
    yaw: float
    gripper: float
    duration_s: float
    hold_s: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0

    @property
    def turn(self) -> np.ndarray:
        """Yaw, pitch and roll, (3,)."""
        return np.array([self.yaw, self.pitch, self.roll])


@dataclass(frozen=True, slots=True)
class Path:
    """Targets at every control step.

    Attributes:
        pos: End effector positions, (T, 3).
        turn: Yaw, pitch and roll, (T, 3).
        gripper: Distance of each fingertip from the middle, m, (T,).
    """

    pos: np.ndarray
    turn: np.ndarray
    gripper: np.ndarray


def grasp_yaw(object_yaw: float, symmetry_rad: float = np.pi / 2) -> float:
    """Returns the smallest turn of the gripper that lines it up with an object of that symmetry."""
    return float((object_yaw + symmetry_rad / 2) % symmetry_rad - symmetry_rad / 2)


def miss(rng: np.random.Generator, *, often_m: float = 0.015, seldom_m: float = 0.05) -> float:
    """Draws the standard deviation, m, of the noise on an expert's first waypoint.

    With a probability of 0.3 it is large, so that demonstrations show recovery from states that a policy
    reaches by its own errors (DART, arXiv:1703.09327).
    """
    return seldom_m if rng.uniform() < 0.3 else often_m


def first_miss(
    rng: np.random.Generator,
    up_m: tuple[float, float] | None = None,
    often_m: float = 0.01,
    seldom_m: float = 0.03,
) -> np.ndarray:
    """Draws how far an expert's waypoint is off, m, (3,): by :func:`miss`, and above by ``up_m``."""
    aside = rng.normal(0.0, miss(rng, often_m=often_m, seldom_m=seldom_m), 2)
    return np.array([*aside, rng.uniform(*up_m) if up_m else 0.0])


def approach(way: Waypoint, rng: np.random.Generator, seldom_m: float = 0.05) -> list[Waypoint]:
    """Returns the path to a waypoint: direct, or with a probability of 0.3 by a point beside it.

    Args:
        way: The waypoint.
        rng: Random number generator.
        seldom_m: Standard deviation of how far beside, along x and y each.
    """
    aside = rng.normal(0.0, miss(rng, often_m=0.0, seldom_m=seldom_m), 2)
    if not aside.any():
        return [way]
    return [replace(way, pos=way.pos + np.array([*aside, 0.0])), replace(way, duration_s=correction_s(aside))]


def correction_s(aside: np.ndarray) -> float:
    """Returns the time to come back from a place that is ``aside`` (n,) m off."""
    return 0.1 + 2.0 * float(np.linalg.norm(aside))


def minimum_jerk(count: int) -> np.ndarray:
    """Returns ``count`` fractions from above 0 to 1 of a movement of least jerk.

    Flash and Hogan, "The coordination of arm movements", J. Neurosci. 5 (1985): 10τ³ − 15τ⁴ + 6τ⁵.
    """
    tau = np.arange(1, count + 1) / count
    return 10 * tau**3 - 15 * tau**4 + 6 * tau**5


def interpolate(start: Waypoint, waypoints: Sequence[Waypoint], control_hz: float) -> Path:
    """Returns the path from ``start`` through the waypoints, one target per control step.

    Positions and turns move with least jerk; fingers move at once, as their motors do.
    """
    pos, turn, gripper = [], [], []
    last = start
    for waypoint in waypoints:
        count = max(1, round(waypoint.duration_s * control_hz))
        hold = round(waypoint.hold_s * control_hz)
        share = np.concatenate([minimum_jerk(count), np.ones(hold)])[:, None]
        pos.append(last.pos + share * (waypoint.pos - last.pos))
        turn.append(last.turn + share * (waypoint.turn - last.turn))
        gripper.append(np.full(count + hold, waypoint.gripper))
        last = waypoint
    return Path(np.concatenate(pos), np.concatenate(turn), np.concatenate(gripper))

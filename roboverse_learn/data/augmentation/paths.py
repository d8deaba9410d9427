"""Bridges: how the hand comes from where it is to the moved path of a source."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from envs.kinematics.waypoints import correction_s, minimum_jerk
from envs.rotations import conjugate, multiply
from roboverse_learn.data.augmentation.pose import Pose, angle_rad, distance_m, partly

BRIDGE_SPEED_RAD_S = 4.0
"""Fastest turn of a bridge: what the experts' own ways of 0.4 s per radian reach, by least jerk."""

SAME_M, SAME_RAD = 1e-3, 1e-2
"""A hand that is this near to the beginning of a piece needs no bridge."""


@dataclass(frozen=True, slots=True)
class HandPath:
    """Hand poses at every control step.

    Attributes:
        pose: (T,).
        rows: Which pose of the source each has its gripper from, (T,).
    """

    pose: Pose
    rows: np.ndarray


def bridged(
    path: Pose,
    start: Pose,
    free: tuple[int, int],
    *,
    speed_m_s: float,
    control_hz: float,
    miss: np.ndarray,
    waits: bool,
    long_way: bool = False,
) -> HandPath:
    """Returns a path that begins at ``start`` and is ``path`` from the end of the free window on.

    Inside the window the offset between both vanishes with least jerk, in the time that a bounded speed
    takes. A miss is where the hand arrives at first; a correction follows.

    Args:
        path: Hand poses of the piece, (T,).
        start: The hand now.
        free: First and one past the last step in which the path may be left; what is between only has the
            source's shape, and takes as long as the speed needs.
        speed_m_s: Bound of the speed in the window.
        control_hz: Control steps per second.
        miss: How far the bridge misses, m, (3,).
        waits: Whether the path waits for the correction: a carried object must be over its target before it
            is put down. If not, the correction is made on the way.
        long_way: Turn the hand the other way round, where a joint's limit is in the way.
    """
    count = len(path.pos)
    begin, end = (min(step, count - 1) for step in free)
    offset, turn = start.pos - path.pos[0], multiply(start.rot, conjugate(path.rot[0]))
    is_there = np.linalg.norm(offset) < SAME_M and angle_rad(start, path.rows(0)) < SAME_RAD
    if is_there and begin == end:
        return HandPath(path, np.arange(count))

    def window(steps: int) -> tuple[Pose, np.ndarray]:
        done = minimum_jerk(steps)
        rows, between = _between(path, begin + (end - begin) * np.arange(1, steps + 1) / steps)
        pos = between.pos + (1.0 - done)[:, None] * offset + done[:, None] * miss
        return Pose(pos, multiply(partly(turn, 1.0 - done, long_way=long_way), between.rot)), rows

    first = path.rows(slice(None, begin))
    lifted = Pose(first.pos + offset, multiply(turn, first.rot))
    steps = _num_steps(window, speed_m_s, control_hz)
    inside, rows = window(steps)
    fading = np.zeros(0)
    if miss.any():
        fading = 1.0 - minimum_jerk(round(correction_s(miss) * control_hz))
    after = np.arange(end + 1, count)
    if waits:
        after = np.concatenate([np.full(len(fading), end), after])
    fading = np.concatenate([fading, np.zeros(len(after))])[: len(after)]
    last = path.rows(after)
    exact = Pose(last.pos + fading[:, None] * miss, last.rot)
    parts = (lifted, inside, exact)
    pose = Pose(np.concatenate([part.pos for part in parts]), np.concatenate([part.rot for part in parts]))
    return HandPath(pose, np.concatenate([np.arange(begin), rows, after]))


def _num_steps(window: Callable[[int], tuple[Pose, np.ndarray]], speed_m_s: float, control_hz: float) -> int:
    """Returns the least number of steps in which a window stays below the speeds."""
    fine = 32
    pose, _ = window(fine)
    later, before = pose.rows(slice(1, None)), pose.rows(slice(None, -1))
    fastest = max(
        float(distance_m(later, before).max()) / speed_m_s,
        float(angle_rad(later, before).max()) / BRIDGE_SPEED_RAD_S,
    )
    return max(1, int(np.ceil(fastest * fine * control_hz)))


def _between(path: Pose, places: np.ndarray) -> tuple[np.ndarray, Pose]:
    """Returns the path at fractional rows (T,): the rows at or after them, and the interpolated poses."""
    places = np.minimum(places, len(path.pos) - 1)
    low, high = np.floor(places).astype(np.int64), np.ceil(places).astype(np.int64)
    share = (places - low)[:, None]
    pos = (1.0 - share) * path.pos[low] + share * path.pos[high]
    near = path.rot[high] * np.where((path.rot[low] * path.rot[high]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    rot = (1.0 - share) * path.rot[low] + share * near
    return high, Pose(pos, rot / np.linalg.norm(rot, axis=-1, keepdims=True))

"""How well an episode was steered: duration, path of the hand, and share of steps at rest."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from envs.rotations import conjugate, multiply
from envs.scenario import RobotCfg

IDLE_M_S, IDLE_RAD_S, IDLE_FINGER_M_S = 0.02, 0.1, 0.01
"""A hand that moves slower than this, in all three ways, is idle."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Quality:
    """Figures of one episode.

    Attributes:
        seconds: Simulated duration.
        path_m: Length of the hand's path.
        idle_share: Share of the control steps in which the hand neither moves, turns, nor grips.
    """

    seconds: float
    path_m: float
    idle_share: float

    def to_json(self) -> dict[str, float]:
        """Returns the figures, rounded, as JSON values."""
        return {key: round(value, 4) for key, value in asdict(self).items()}


def measure(states: Mapping[str, np.ndarray], robot: RobotCfg, control_hz: float) -> Quality:
    """Measures an episode of T steps.

    Args:
        states: Flattened states in T + 1 rows; see :meth:`envs.state.State.flatten`.
        robot: The robot whose hand is steered.
        control_hz: Control steps per second.
    """
    prefix = f"robots/{robot.name}/"
    pos, rot = states[f"{prefix}ee_pos"], states[f"{prefix}ee_rot"]
    fingers = [robot.joint_names.index(name) for name in robot.gripper_joints]
    joints = states[f"{prefix}joint_pos"][:, fingers]
    steps = len(pos) - 1
    way = np.linalg.norm(np.diff(pos, axis=0), axis=1)
    change = multiply(rot[1:], conjugate(rot[:-1]))
    turn = 2.0 * np.arctan2(np.linalg.norm(change[:, 1:], axis=1), np.abs(change[:, 0]))
    grip = np.abs(np.diff(joints, axis=0)).max(axis=1, initial=0.0)
    speeds = ((way, IDLE_M_S), (turn, IDLE_RAD_S), (grip, IDLE_FINGER_M_S))
    idle = np.all([speed * control_hz < limit for speed, limit in speeds], axis=0)
    return Quality(
        seconds=steps / control_hz,
        path_m=float(way.sum()),
        idle_share=float(idle.mean()) if steps else 0.0,
    )


def mean(qualities: "list[Quality]") -> Quality | None:
    """Returns the means of the figures; None of no episode."""
    if not qualities:
        return None
    rows: list[dict[str, Any]] = [asdict(quality) for quality in qualities]
    return Quality(**{key: float(np.mean([row[key] for row in rows])) for key in rows[0]})

"""The hand's path for one piece: the source's, moved with the object, and bridged from where the hand is.

T_new(t) = T_object_now T_object_source⁻¹ T_hand_source(t), after MimicGen (arXiv:2310.17596, section 4). For a
carried object it is the object's path that is moved: where the hand holds it otherwise than the source did,
the object still comes to the same place.
"""

from dataclasses import dataclass

import numpy as np

from envs.kinematics.waypoints import correction_s, minimum_jerk
from envs.rotations import conjugate, multiply
from roboverse_learn.data.augmentation.pose import Pose, angle_rad, distance_m, partly

PEAK_SPEED = 1.875
"""Largest speed of a minimum-jerk movement, by its mean speed."""

BRIDGE_SPEED_RAD_S = 2.0
"""Fastest turn of the hand to the beginning of a piece: less than the limit of the Panda's slowest joints,
2.175 rad/s (Franka Emika, "Robot and interface specifications")."""

SAME_M, SAME_RAD = 1e-3, 1e-2
"""A hand that is this near to the beginning of a piece needs no bridge."""


@dataclass(frozen=True, slots=True)
class HandPath:
    """Hand poses at every control step.

    Attributes:
        pose: (T,).
        steps: The source's step that each has its gripper from, counted from the piece's first, (T,).
    """

    pose: Pose
    steps: np.ndarray


def moved(path: Pose, source: Pose, now: Pose, held: tuple[Pose, Pose] | None = None) -> Pose:
    """Returns a source's hand path, moved with its object.

    Args:
        path: The source's hand, (T,).
        source: The object when the source's piece began.
        now: The object now.
        held: The hand in the carried object's frame, in the source and now, or None.
    """
    if held is not None:
        path = path @ (held[0].inverse() @ held[1])
    return now @ source.inverse() @ path


def bridge_steps(start: Pose, first: Pose, speed_m_s: float, control_hz: float) -> int:
    """Returns how many control steps a bridge takes at a bounded speed; 0 where none is needed."""
    way, turn = float(distance_m(start, first)), float(angle_rad(start, first))
    if way < SAME_M and turn < SAME_RAD:
        return 0
    seconds = PEAK_SPEED * max(way / speed_m_s, turn / BRIDGE_SPEED_RAD_S)
    return int(np.ceil(seconds * control_hz - 1e-9))


def bridged(
    path: Pose, start: Pose, free: tuple[int, int], speed_m_s: float, control_hz: float, miss: np.ndarray
) -> HandPath:
    """Returns a path that begins at ``start`` and is ``path`` from the end of the free window on.

    The offset between both vanishes with least jerk inside the window. Where the window is too short for the
    speed, the path waits at its end. A miss is where the hand arrives first; a correction follows.

    Args:
        path: Hand poses of the piece, (T,).
        start: The hand now.
        free: First and one past the last step in which the path may be left.
        speed_m_s: Bound of the bridge's speed.
        control_hz: Control steps per second.
        miss: How far the bridge misses, m, (3,).
    """
    count = len(path.pos)
    begin, end = (min(step, count - 1) for step in free)
    bridge = bridge_steps(start, path.rows(0), speed_m_s, control_hz)
    num_bridge = max(bridge, end - begin)
    num_wait = num_bridge - (end - begin)
    num_correction = round(correction_s(miss) * control_hz) if num_bridge and miss.any() else 0
    steps = np.concatenate(
        [np.arange(end), np.full(num_wait + num_correction, end), np.arange(end, count)]
    ).astype(np.int64)
    done = np.ones(len(steps))  # share of the offset that has vanished
    done[:begin] = 0.0
    done[begin : begin + num_bridge] = minimum_jerk(num_bridge)
    missed = np.zeros(len(steps))  # share of the miss
    if num_correction:
        back = begin + num_bridge
        missed[begin:back] = done[begin:back]
        missed[back : back + num_correction] = 1.0 - minimum_jerk(num_correction)
    offset, turn = start.pos - path.pos[0], multiply(start.rot, conjugate(path.rot[0]))
    pos = path.pos[steps] + (1.0 - done)[:, None] * offset + missed[:, None] * miss
    rot = multiply(partly(turn, 1.0 - done), path.rot[steps])
    return HandPath(Pose(pos, rot), steps)

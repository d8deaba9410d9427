"""The expert's way of a held thing to before a hole, and into it."""

from dataclasses import dataclass

import numpy as np

from envs.kinematics.waypoints import Waypoint, correction_s, miss
from envs.rotations import from_yaw, rotate, wrapped
from envs.state import State
from envs.tasks.arm_at_table import ArmAtTable, heading, point, travel_s
from envs.tasks.tabletop import GRASP_CLOSED_M, ee_pos

FAR_M = 0.02
"""Error from which the expert moves as if it had just begun."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Insertion:
    """Where a thing goes.

    Attributes:
        item: Name of the object, whose x axis points into the hole.
        goal: Its position when it is inserted, m, (3,).
        line: Heading of the hole, rad.
        back_m: Distance from there, against the heading, at which it is lined up.
        exact_m: Error across the hole at which the expert begins to insert it.
        exact_rad: Likewise of its turn and its tilt.
        speed_m_s: Mean speed of the insertion.
    """

    item: str
    goal: np.ndarray
    line: float
    back_m: float
    exact_m: float
    exact_rad: float
    speed_m_s: float = 0.125


def insertion_way(
    task: ArmAtTable, state: State, where: Insertion, rng: np.random.Generator
) -> list[Waypoint]:
    """Returns the next part of the way, of a state of one row: to the hole, a correction, or into it.

    A load keeps the hand from its targets: each part moves the targets by what the thing still lacks.
    """
    item, now = state.objects[where.item], task.commanded(state)
    hand = ee_pos(task.arm(state))[0].numpy()
    spin = float(wrapped(where.line - heading(item)))
    droop = float(rotate(item.rot[0].numpy(), np.array([1.0, 0.0, 0.0]))[2])
    in_hand = rotate(from_yaw(spin), hand - point(item))
    axis = np.array([np.cos(where.line), np.sin(where.line), 0.0])

    def at(along_m: float, duration_s: float, hold_s: float, aside: np.ndarray | None = None) -> Waypoint:
        """The thing so far along the hole from its goal."""
        pos = now.pos + where.goal + along_m * axis + in_hand - hand
        return Waypoint(
            pos=pos if aside is None else pos + aside,
            yaw=now.yaw + spin,
            pitch=now.pitch + droop,
            roll=now.roll,
            gripper=GRASP_CLOSED_M,
            duration_s=duration_s,
            hold_s=hold_s,
        )

    ready = where.goal - where.back_m * axis
    left = ready - point(item)
    ahead = -float(left @ axis)  # of where it is lined up
    off = float(np.linalg.norm(left + ahead * axis))
    lined = off < where.exact_m and max(abs(spin), abs(droop)) < where.exact_rad
    if lined or (ahead > 1.5 * FAR_M and off < FAR_M):
        return [at(0.0, 0.4 + (where.back_m - ahead) / where.speed_m_s, 0.2)]
    if off < FAR_M:
        return [at(-where.back_m, 0.3, 0.25)]
    # The way first misses: the next motion demonstrates the correction.
    aside = rng.normal(0.0, miss(rng, often_m=0.008, seldom_m=0.02), 2)
    missed = np.array([aside[0], 0.0, 0.5 * abs(aside[1])])
    way_s = travel_s(point(item), ready, 0.5) + 0.4 * abs(spin)
    return [
        at(-where.back_m - 0.02, way_s, 0.0, missed),
        at(-where.back_m, correction_s(aside) + 0.3, 0.2),
    ]

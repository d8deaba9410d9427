"""The expert's way of a held thing to over its place, and down into it."""

from dataclasses import dataclass, replace

import numpy as np

from envs.kinematics.waypoints import Waypoint, correction_s, miss
from envs.rotations import from_yaw, rotate, wrapped
from envs.state import State
from envs.tasks.arm_at_table import ArmAtTable, heading, point, travel_s
from envs.tasks.tabletop import GRASP_CLOSED_M, ee_pos

FAR_M = 0.02
"""Error from which the expert moves as if it had just begun."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Lowering:
    """Where a thing goes.

    Attributes:
        item: Name of the object.
        goal: Its position where the hand lets go of it, m, (3,).
        yaw: Its turn there, rad.
        over_m: Height over that place at which it is lined up.
        exact_m: Level error at which the expert begins to lower it.
        exact_rad: Likewise of its turn.
        opening_m: Distance of each finger from the middle after it has let go.
    """

    item: str
    goal: np.ndarray
    yaw: float
    over_m: float
    exact_m: float
    exact_rad: float
    opening_m: float


def lowering_way(task: ArmAtTable, state: State, where: Lowering, rng: np.random.Generator) -> list[Waypoint]:
    """Returns the next part of the way, of a state of one row: over the place, a correction, or down to it.

    A load keeps the hand from its targets: each part moves the targets by what the thing still lacks.
    """
    item, now = state.objects[where.item], task.commanded(state)
    hand, place = ee_pos(task.arm(state))[0].numpy(), point(item)
    spin = float(wrapped(where.yaw - heading(item)))
    in_hand = rotate(from_yaw(spin), hand - place)

    def at(over_m: float, duration_s: float, hold_s: float = 0.0) -> Waypoint:
        """The thing so far over its place."""
        pos = now.pos + where.goal + np.array([0.0, 0.0, over_m]) + in_hand - hand
        turned = replace(now, pos=pos, yaw=now.yaw + spin, gripper=GRASP_CLOSED_M)
        return replace(turned, duration_s=duration_s, hold_s=hold_s)

    off = float(np.linalg.norm((where.goal - place)[:2]))
    high = float(place[2] - where.goal[2])
    if off < where.exact_m and abs(spin) < where.exact_rad:
        low = at(0.0, 0.4 + 6.0 * high, 0.15)
        let_go = replace(low, gripper=where.opening_m, duration_s=0.3, hold_s=0.15)
        up = low.pos + np.array([0.0, 0.0, where.over_m + 0.04])
        return [low, let_go, replace(let_go, pos=up, duration_s=0.6, hold_s=0.0)]
    if off < FAR_M:
        return [at(where.over_m, 0.3, 0.25)]
    # The way first misses: the next motion demonstrates the correction.
    aside = rng.normal(0.0, miss(rng, often_m=0.008, seldom_m=0.02), 2)
    near = at(where.over_m, travel_s(place, where.goal, 0.5) + 0.4 * abs(spin))
    rise = []
    if high < where.over_m - 0.02:
        lifted = now.pos + np.array([0.0, 0.0, where.over_m - high])
        rise = [replace(now, pos=lifted, gripper=GRASP_CLOSED_M, duration_s=0.6)]
    missed = replace(near, pos=near.pos + np.array([*aside, 0.0]))
    return [*rise, missed, at(where.over_m, correction_s(aside) + 0.3, 0.2)]

"""The way of a held thing to before its place, and into it: level into a hole, or down into a frame."""

import math
from dataclasses import dataclass, replace

import numpy as np

from envs.kinematics.waypoints import Waypoint, correction_s, miss
from envs.tasks.skills.held import Held, Pose

FAR_M = 0.02
"""Error from which the expert moves as if it had just begun."""

UP, DOWN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Insertion:
    """Where a thing goes.

    Attributes:
        goal: Its pose when it is inserted.
        into: Direction of the last part of its way, (3,).
        back_m: Distance from the goal, against that direction, at which it is lined up.
        exact_m: Error across the direction at which the expert begins to insert it.
        exact_rad: Likewise of its orientation.
        speed_m_s: Mean speed of the insertion.
        carry_m_s: Mean speed of the way to where it is lined up.
        step_m: Longest part of the insertion, after which what lacks is corrected.
        opening_m: Distance of each finger from the middle when the hand has let go and draws back; without it
            the hand keeps the thing.
    """

    goal: Pose
    into: np.ndarray
    back_m: float
    exact_m: float
    exact_rad: float
    speed_m_s: float = 0.125
    carry_m_s: float = 0.67
    step_m: float = math.inf
    opening_m: float | None = None


def insertion_way(held: Held, where: Insertion, rng: np.random.Generator) -> list[Waypoint]:
    """Returns the next part of the way: to before the place, a correction, or into it."""
    into, back = where.into, where.back_m

    def at(along_m: float, duration_s: float, hold_s: float, aside: np.ndarray | None = None) -> Waypoint:
        """The thing so far along the direction from its goal."""
        pos = where.goal.pos + along_m * into
        return held.to(Pose(pos if aside is None else pos + aside, where.goal.rot), duration_s, hold_s)

    ready = where.goal.pos - back * into
    left, turn = ready - held.pose.pos, held.pose.turn_to(where.goal)
    ahead = -float(left @ into)  # of where it is lined up
    off = float(np.linalg.norm(left + ahead * into))
    lined = off < where.exact_m and turn < where.exact_rad
    # What is part of the way in goes on; but what is let go of at the end lines up again.
    part_in = where.opening_m is None and ahead > 1.5 * FAR_M and off < FAR_M
    if lined or part_in:
        length = min(back - ahead, where.step_m)
        inside = at(ahead + length - back, 0.4 + max(length, 0.0) / where.speed_m_s, 0.2)
        return [inside, *(_let_go(inside, where) if length < where.step_m else [])]
    if off < FAR_M:
        return [at(-back, 0.3 + 2.0 * abs(ahead), 0.25)]
    # The way first misses: the next motion demonstrates the correction.
    aside = _beside(into, rng)
    way_s = 0.5 + float(np.linalg.norm(ready - held.pose.pos)) / where.carry_m_s + 0.4 * turn
    lower = float(left @ UP)
    return [
        *([held.moved(lower * UP, 0.5 + 1.5 * lower)] if lower > FAR_M else []),
        at(-back - 0.02, way_s, 0.0, aside),
        at(-back, correction_s(aside) + 0.3, 0.2),
    ]


def _let_go(inside: Waypoint, where: Insertion) -> list[Waypoint]:
    """Returns the way of fingers that open, and of the hand back out; none if it keeps what it holds."""
    if where.opening_m is None:
        return []
    opened = replace(inside, gripper=where.opening_m, duration_s=0.3, hold_s=0.15)
    back = inside.pos - (where.back_m + 0.04) * where.into
    return [opened, replace(opened, pos=back, duration_s=0.6, hold_s=0.0)]


def _beside(into: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draws how far the end of the way is off, across the direction, m, (3,); of a level one never below."""
    first, second = rng.normal(0.0, miss(rng, often_m=0.008, seldom_m=0.02), 2)
    side = np.cross(into, UP)
    if np.linalg.norm(side) < 0.1:
        return np.array([first, second, 0.0])
    return first * side / np.linalg.norm(side) + 0.5 * abs(second) * UP

"""TwoArmLift, after robosuite 1.5.1 (``environments/manipulation/two_arm_lift.py``, MIT).

The pot is that of ``models/objects/composite/pot_with_handles.py``. The reward is robosuite's shaped one; it
reads a grasp from contacts, here a handle is grasped when it keeps closing fingers apart.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import at_least, concatenate
from envs.kinematics.waypoints import Waypoint, first_miss
from envs.rotations import uprightness
from envs.scenario import GeomCfg, ObjectCfg, Quat, Rgba, Vec3
from envs.state import State
from envs.tasks.arm_at_table import Start, above, travel_s
from envs.tasks.arms import DOWN, Hand, in_world, pointing
from envs.tasks.arms_planner import Phase
from envs.tasks.robosuite.two_arms import TwoArms
from envs.tasks.skills.from_above import grasp
from envs.tasks.tabletop import (
    DENSITY_KG_M3,
    GRASP_OPEN_M,
    distance,
    ee_pos,
    nearness,
    point_on,
)

HALF_M, WALL_M = 0.07, 0.01
BAR_M, HANDLE_M = 0.01, 0.09
"""Half the width of a handle's bars, and how far it stands off; it is as wide."""

HANDLE_Z_M = HALF_M - BAR_M
SITE_Y_M = HALF_M + HANDLE_M - 0.005
HANDLES: tuple[Vec3, Vec3] = ((0.0, SITE_Y_M, HANDLE_Z_M), (0.0, -SITE_Y_M, HANDLE_Z_M))
"""Where each robot takes hold, in the pot's frame."""

MOST_TILT_RAD = math.pi / 6
_WOOD: Rgba = (0.45, 0.12, 0.08, 1.0)
_COLORS: tuple[Rgba, Rgba] = ((0.15, 0.5, 0.15, 1.0), (0.1, 0.2, 0.6, 1.0))
_TURNED: Quat = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))


def _pot() -> ObjectCfg:
    off, wall = HALF_M - WALL_M / 2, (WALL_M / 2, HALF_M, HALF_M)
    geoms = [GeomCfg.box((HALF_M, HALF_M, WALL_M / 2), (0.0, 0.0, -off), _WOOD, DENSITY_KG_M3)]
    geoms += [GeomCfg.box(wall, (sign * off, 0.0, 0.0), _WOOD, DENSITY_KG_M3) for sign in (-1.0, 1.0)]
    geoms += [
        GeomCfg.box(wall, (0.0, sign * off, 0.0), _WOOD, DENSITY_KG_M3, rot=_TURNED) for sign in (-1.0, 1.0)
    ]
    for sign, rgba in zip((1.0, -1.0), _COLORS, strict=True):
        bar = (HANDLE_M / 2 + BAR_M, BAR_M, BAR_M)
        geoms.append(GeomCfg.box(bar, (0.0, sign * (HALF_M + HANDLE_M), HANDLE_Z_M), rgba, DENSITY_KG_M3))
        side, y = (BAR_M, HANDLE_M / 2, BAR_M), sign * (HALF_M + HANDLE_M / 2)
        geoms += [
            GeomCfg.box(side, (x, y, HANDLE_Z_M), rgba, DENSITY_KG_M3) for x in (-HANDLE_M / 2, HANDLE_M / 2)
        ]
    return ObjectCfg(name="pot", geoms=tuple(geoms), pos=(0.0, 0.0, HALF_M))


@dataclass(frozen=True, kw_only=True)
class TwoArmLift(TwoArms):
    """Lift a pot by both of its handles.

    Attributes:
        spawn_half_size_m: Half the side of the square of the pot's start.
        yaw_half_rad: Largest turn of its start from that in which its handles point at the robots.
        height_m: Height of its bottom above the table that is a success.
    """

    name: ClassVar[str] = "TwoArmLift"
    instructions: ClassVar[tuple[str, ...]] = (
        "lift the pot by both of its handles",
        "take one handle with each arm and raise the pot",
        "pick up the pot together",
    )
    max_episode_steps: ClassVar[int] = 200

    spawn_half_size_m: float = 0.03
    yaw_half_rad: float = math.pi / 3
    height_m: float = 0.1

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (_pot(), *self.pedestals)

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        place = rng.uniform(-self.spawn_half_size_m, self.spawn_half_size_m, 2)
        turn = math.pi + rng.uniform(-self.yaw_half_rad, self.yaw_half_rad)
        return {"pot": Start((*place, HALF_M), turn)}

    @override
    def success(self, state: State) -> Tensor:
        return state.objects["pot"].pos[:, 2] - HALF_M > self.height_m

    @override
    def reward(self, state: State) -> Tensor:
        """Returns robosuite's: height of a level pot, and reach and grasp of each handle; over 3."""
        pot = state.objects["pot"]
        level = uprightness(pot.rot) >= math.cos(MOST_TILT_RAD)
        risen = at_least(pot.pos[:, 2] - HALF_M - 0.05, 0.0)
        total = 10.0 * level * (risen - at_least(risen - 0.15, 0.0))
        for index, handle in enumerate(HANDLES):
            place = point_on(pot, handle)
            total = total + 0.5 * nearness(distance(self._hand(state, index), place), 10.0)
            total = total + 0.25 * self.grasps(state, index, place, 2 * BAR_M)
        return total / 3.0

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the pot's pose, its handles, end effectors, and ways between them, (N, 25)."""
        pot, hands = state.objects["pot"], [self._hand(state, index) for index in (0, 1)]
        handles = [point_on(pot, handle) for handle in HANDLES]
        ways = [handle - hand for handle, hand in zip(handles, hands, strict=True)]
        return concatenate((pot.pos, pot.rot, *handles, *hands, *ways))

    @override
    def phases(self, state: State, rng: np.random.Generator) -> list[Phase]:
        hands = [self.hand(state, index) for index in (0, 1)]
        lifted = 0.17 + rng.uniform(0.0, 0.03)
        takes = [self._take(state, index, hand, rng) for index, hand in enumerate(hands)]
        lifts = [replace(way[-1], pos=above(way[-1].pos, lifted), duration_s=1.2) for way in takes]
        return [
            {hand.name: way for hand, way in zip(hands, takes, strict=True)},
            {hand.name: [lift] for hand, lift in zip(hands, lifts, strict=True)},
        ]

    def _take(self, state: State, index: int, hand: Hand, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way to grasp a handle from above; the approach first misses."""
        pot = state.objects["pot"]
        x, y, z = HANDLES[index]
        bar = in_world(pot, (x, y + math.copysign(0.005, y), z))
        rot = hand.nearer(pointing(DOWN, in_world(pot, (0.0, 1.0, 0.0)) - in_world(pot, (0.0, 0.0, 0.0))))
        over = above(bar, 0.08) + first_miss(rng, (0.0, 0.02), often_m=0.008)
        return [
            hand.to(over, rot, GRASP_OPEN_M, travel_s(hand.pos, over, 1.0)),
            *grasp(hand.to(above(bar, 0.05), rot, GRASP_OPEN_M, 0.3, hold_s=0.1), bar, None),
        ]

    def _hand(self, state: State, index: int) -> Tensor:
        return ee_pos(state.robots[self.robots[index].name])

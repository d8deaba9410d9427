"""PushCube and PullCube, after ManiSkill 3 (``tabletop/push_cube.py`` and ``tabletop/pull_cube.py``).

The reward is ManiSkill's: reach the far or near side of the cube, then slide the cube to the target.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import concatenate, constant
from envs.kinematics.waypoints import Waypoint, approach, first_miss
from envs.scenario import CameraCfg, ObjectCfg
from envs.state import State
from envs.tasks.arm_at_table import ArmAtTable, Start, point, way
from envs.tasks.maniskill.parts import BLUE, CUBE_HALF_SIZE_M, GOAL_Z_M, cube, target
from envs.tasks.skills.from_above import slide
from envs.tasks.tabletop import FRONT_CAMERA, GRASP_CLOSED_M, distance, ee_pos, flat_distance, nearness

FINGER_HALF_WIDTH_M = 0.011
"""Half of a fingertip, across the direction in which the fingers close."""


@dataclass(frozen=True, kw_only=True)
class SlideCube(ArmAtTable):
    """A cube that is slid along x onto a target.

    Attributes:
        cube_half_size_m: Half the side of the cube.
        spawn_half_size_m: Half the side of the square of the cube's start.
        goal_radius_m: Radius of the target; the cube's centre has to be within.
        goal_gap_m: Distance of the target's edge from the cube's start.
        reach_tolerance_m: Distance of the hand from where it moves the cube, within which the reward
            counts the cube's way.
    """

    max_episode_steps: ClassVar[int] = 100
    side: ClassVar[float]
    """Sign of the target's way from the cube along x."""
    hold_gap_m: ClassVar[float]
    """Distance of the hand from the cube's face in the reward."""

    cube_half_size_m: float = CUBE_HALF_SIZE_M
    spawn_half_size_m: float = 0.1
    goal_radius_m: float = 0.1
    goal_gap_m: float = 0.1
    reach_tolerance_m: float = 0.01

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (cube("cube", self.cube_half_size_m, BLUE), target("goal", self.goal_radius_m))

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        x, y = rng.uniform(-self.spawn_half_size_m, self.spawn_half_size_m, 2)
        goal_x = x + self.side * (self.goal_gap_m + self.goal_radius_m)
        return {"cube": Start((x, y, self.cube_half_size_m)), "goal": Start((goal_x, y, GOAL_Z_M))}

    @override
    def success(self, state: State) -> Tensor:
        return self._left(state) < self.goal_radius_m

    @override
    def reward(self, state: State) -> Tensor:
        """Returns ManiSkill's: nearness to where the hand moves the cube, then that of cube and target."""
        item, hand = state.objects["cube"].pos, ee_pos(self.arm(state))
        offset = -self.side * (self.cube_half_size_m + self.hold_gap_m)
        reach = distance(item + constant((offset, 0.0, 0.0), item), hand)
        reached = reach < self.reach_tolerance_m
        return (nearness(reach) + nearness(self._left(state)) * reached) / 3.0

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the cube's pose, target, end effector, and ways between them, (N, 19)."""
        item, goal = state.objects["cube"], state.objects["goal"].pos
        hand = ee_pos(self.arm(state))
        return concatenate((item.pos, item.rot, goal, hand, item.pos - hand, goal - item.pos))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        item, goal = point(state.objects["cube"]), point(state.objects["goal"])
        touch = self.cube_half_size_m + FINGER_HALF_WIDTH_M
        along = np.array([self.side, 0.0, 0.0])
        behind = item - (touch + rng.uniform(0.015, 0.03)) * along
        # The approach first misses: the next motion demonstrates the correction.
        noise = first_miss(rng, (0.06, 0.09), often_m=0.015)
        noise[0] = -self.side * abs(noise[0])
        end = np.array([goal[0], item[1], item[2]]) - (touch + 0.6 * self.goal_radius_m) * along
        push_s = 0.3 + 4.0 * float(np.linalg.norm(end - behind)) * rng.uniform(0.9, 1.2)
        come = approach(way(behind + noise, 0.0, GRASP_CLOSED_M, 0.8), rng, 0.03)
        return [
            *self.rise(state, 0.08),
            *come,
            *slide(come[-1], (behind, end), (0.5, push_s), settle_s=0.1),
        ]

    def _left(self, state: State) -> Tensor:
        return flat_distance(state.objects["cube"].pos, state.objects["goal"].pos)


@dataclass(frozen=True, kw_only=True)
class PushCube(SlideCube):
    """Push a cube away from the robot onto the target before it.

    Attributes:
        lift_tolerance_m: Height above its start at which the cube no longer counts as on the table.
    """

    name: ClassVar[str] = "PushCube"
    instructions: ClassVar[tuple[str, ...]] = (
        "push the blue cube onto the target",
        "push the cube forward until it is in the goal region",
        "slide the blue cube away from you onto the red and white circle",
    )
    side: ClassVar[float] = 1.0
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, look_at=(0.08, 0.0, 0.06), fovy_deg=36.0)
    hold_gap_m: ClassVar[float] = 0.005

    lift_tolerance_m: float = 0.005

    @override
    def success(self, state: State) -> Tensor:
        low = state.objects["cube"].pos[:, 2] < self.cube_half_size_m + self.lift_tolerance_m
        return super().success(state) & low


@dataclass(frozen=True, kw_only=True)
class PullCube(SlideCube):
    """Pull a cube towards the robot onto the target before it."""

    name: ClassVar[str] = "PullCube"
    instructions: ClassVar[tuple[str, ...]] = (
        "pull the blue cube onto the target",
        "pull the cube back until it is in the goal region",
        "slide the blue cube towards you onto the red and white circle",
    )
    side: ClassVar[float] = -1.0
    hold_gap_m: ClassVar[float] = 0.01

"""TwoArmHandover, after robosuite 1.5.1 (``environments/manipulation/two_arm_handover.py``, MIT).

robosuite draws the hammer's sizes once for each environment; here they are options, in the middle of its
ranges. The reward is robosuite's shaped one; it reads a grasp from contacts, here the hammer is grasped where
it keeps closing fingers apart.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, where
from envs.rotations import from_yaw, multiply
from envs.scenario import ObjectCfg, RobotCfg, TableCfg
from envs.state import EntityState, State
from envs.tasks.arm_at_table import Start
from envs.tasks.arms import pointing
from envs.tasks.arms_planner import Phase
from envs.tasks.robosuite.hammer import LYING, Hammer
from envs.tasks.robosuite.handing_over import FROM_RIGHT, hand_over, pick_up
from envs.tasks.robosuite.scene import TABLE_HEIGHT_M, panda
from envs.tasks.robosuite.two_arms import TwoArms, opposed
from envs.tasks.tabletop import GRASP_CLOSED_M, GRASP_OPEN_M, distance, ee_pos, nearness

AHEAD = 0.6
"""Slope of the left hand's fingers over the middle of the table, 0.8 m from its base."""

MEETING_M = np.array([0.0, -0.05, 0.32])
"""Where the left hand hands the hammer over."""

_LEFT, _RIGHT = range(2)


@dataclass(frozen=True, kw_only=True)
class TwoArmHandover(TwoArms):
    """The left arm picks up a hammer, the right one takes it by its handle.

    Attributes:
        handle_radius_m: Half the width of the handle.
        handle_length_m: Length of the handle.
        handle_density: Its density, kg/m³; the head's is twice that.
        handle_friction: Its friction.
        spawn_half_size_m: Half extents of the hammer's start.
        height_m: Height of the hammer above the table that a success takes.
    """

    name: ClassVar[str] = "TwoArmHandover"
    instructions: ClassVar[tuple[str, ...]] = (
        "pick up the hammer with the left arm and hand it to the right one",
        "pass the hammer from one robot to the other",
        "hand the hammer over so that the right arm holds its handle",
    )
    max_episode_steps: ClassVar[int] = 300
    own_robots: ClassVar[tuple[RobotCfg, ...]] = opposed(panda(0.0), 0.81)
    table: ClassVar[TableCfg] = TableCfg(half_size=(0.4, 0.15), height_m=TABLE_HEIGHT_M)

    handle_radius_m: float = 0.0175
    handle_length_m: float = 0.175
    handle_density: float = 175.0
    handle_friction: float = 4.0
    spawn_half_size_m: tuple[float, float] = (0.1, 0.05)
    height_m: float = 0.1

    @property
    def hammer(self) -> Hammer:
        """The hammer."""
        return Hammer(
            radius_m=self.handle_radius_m,
            length_m=self.handle_length_m,
            density=self.handle_density,
            head_density_ratio=2.0,
            friction=self.handle_friction,
        )

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (self.hammer.as_object("hammer"), *self.pedestals)

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        place = rng.uniform(-1.0, 1.0, 2) * self.spawn_half_size_m
        lying = LYING[int(rng.integers(2))]
        rot = multiply(from_yaw(rng.uniform(0.0, 2 * math.pi)), lying)
        return {"hammer": self.hammer.resting(float(place[0]), float(place[1]), 0.0, rot)}

    @override
    def success(self, state: State) -> Tensor:
        left, right = self._holds(state)
        return right & ~left & self._lifted(state)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns robosuite's stages: reach, grasp, lift, hover near the other arm, both grasp; over 2."""
        hammer, (left, right) = state.objects["hammer"], self._holds(state)
        near = [0.25 * nearness(distance(ee_pos(arm), hammer.pos), 1.0) for arm in self._arms(state)]
        raised = where(right, where(left, 1.5, 2.0), 1.0 + near[_RIGHT])
        return where(self._lifted(state), raised, where(left, 0.5, near[_LEFT])) / 2.001

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the hammer's pose, end effectors, and ways to its handle, (N, 19)."""
        hammer, hands = state.objects["hammer"], [ee_pos(arm) for arm in self._arms(state)]
        ways = [hammer.pos - hand for hand in hands]
        return concatenate((hammer.pos, hammer.rot, *hands, *ways))

    @override
    def phases(self, state: State, rng: np.random.Generator) -> list[Phase]:
        """Returns the way to pick the hammer up, or to hand it over from where the left arm holds it."""
        hammer, left, right = state.objects["hammer"], self.hand(state, _LEFT), self.hand(state, _RIGHT)
        if bool(self._lifted(state)[0]):  # a hammer in the air is in the left hand
            return hand_over(left, right, hammer, self.handle_length_m, rng)
        picks, met = pick_up(left, hammer, self.handle_length_m, rng, slope=AHEAD)
        passing = MEETING_M + rng.uniform(-0.02, 0.02, 3)
        carried = left.to(passing, met, GRASP_CLOSED_M, 2.0, hold_s=0.3)
        waits = passing + np.array([0.0, 0.25, 0.1])
        comes = right.to(waits, right.nearer(pointing(FROM_RIGHT, (1.0, 0.0, 0.0))), GRASP_OPEN_M, 1.5)
        return [{left.name: [*picks, carried], right.name: [comes]}]

    def _arms(self, state: State) -> list[EntityState]:
        return [state.robots[robot.name] for robot in self.robots]

    def _holds(self, state: State) -> tuple[Array, Array]:
        """Returns whether the left arm holds any part, and whether the right one holds the handle."""
        hammer, arms = state.objects["hammer"], self._arms(state)
        own, width = self.hammer, 2 * self.handle_radius_m
        any_part = own.nearest(hammer, ee_pos(arms[_LEFT]), 2 * own.head_m)
        handle = own.nearest(hammer, ee_pos(arms[_RIGHT]))
        return self.grasps(state, _LEFT, any_part, width), self.grasps(state, _RIGHT, handle, width)

    def _lifted(self, state: State) -> Array:
        return self.hammer.height(state.objects["hammer"]) > self.height_m

"""HammerPlace, after the robosuite task zoo (``hammer_place.py``).

The zoo draws the hammer's length and density once for each environment, 45 to 50 mm and 100 to 250 kg/m³;
here they are options, in the middle of its ranges. Its reward is success alone.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate
from envs.kinematics.waypoints import Waypoint, grasp_yaw
from envs.rotations import from_yaw, multiply
from envs.scenario import CameraCfg, ObjectCfg
from envs.state import State
from envs.tasks.arm_at_table import Start
from envs.tasks.robosuite.hammer import LYING, Hammer, along, axis_of
from envs.tasks.robosuite.scene import pedestal
from envs.tasks.skills.from_above import drag, put, shut_drawer, take
from envs.tasks.skills.moves import Hand
from envs.tasks.tabletop import ee_pos
from envs.tasks.task_zoo import parts
from envs.tasks.task_zoo.parts import INSET_M, SHUT_M, TABLE_X_M

CABINET_M = (TABLE_X_M + 0.2, 0.30, 0.03 - INSET_M)
TRAVEL_OF_DRAWER_M = 0.135
INSIDE_Z_M = (0.04, 0.1)
INSIDE_Y_M = 0.22
"""The hammer is in the drawer at these heights, and beyond this y."""

OPEN_M = 0.125
"""How far the expert pulls the drawer out."""

WIDE_M = 0.11
"""Opening from which a hammer fits in."""

BAR_OPENING_M = 0.022
"""Distance of each finger from the bar's middle before it is grasped: there are 46 mm behind it."""

DROP_M = 0.085
"""Height of the grip site where the hand lets go of the hammer."""

TRAVEL_M = 0.22


@dataclass(frozen=True, kw_only=True)
class HammerPlace(parts.ZooTask):
    """Pull the drawer open, put the hammer into it, and push it shut.

    Attributes:
        hammer_x_m: Range of the hammer along x.
        hammer_y_m: Likewise along y.
        hammer_yaw_rad: Range of its turn from either way to lie.
        length_m: Length of its handle.
        density: Its density, kg/m³.
    """

    name: ClassVar[str] = "HammerPlace"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the hammer in the drawer and close the drawer",
        "open the drawer, place the hammer inside and shut it",
        "store the hammer in the cabinet's drawer",
    )
    max_episode_steps: ClassVar[int] = 600
    has_reward: ClassVar[bool] = False
    camera: ClassVar[CameraCfg] = replace(parts.ZooTask.camera, look_at=(-0.1, 0.08, 0.05), fovy_deg=40.0)

    hammer_x_m: tuple[float, float] = (TABLE_X_M + 0.10, TABLE_X_M + 0.18)
    hammer_y_m: tuple[float, float] = (-0.20, -0.13)
    hammer_yaw_rad: tuple[float, float] = (-0.1, 0.1)
    length_m: float = 0.0475
    density: float = 175.0

    @property
    def hammer(self) -> Hammer:
        """The hammer's sizes."""
        return Hammer(
            radius_m=0.012,
            length_m=self.length_m,
            density=self.density,
            head_density_ratio=1.0,
            friction=4.0,
        )

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        chest = replace(parts.cabinet(TRAVEL_OF_DRAWER_M, parts.RED_WOOD), pos=CABINET_M)
        return (self.hammer.as_object("hammer"), chest, pedestal(self.robot))

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        x, y = rng.uniform(*self.hammer_x_m), rng.uniform(*self.hammer_y_m)
        lies = LYING[int(rng.integers(len(LYING)))]
        rot = multiply(from_yaw(rng.uniform(*self.hammer_yaw_rad)), lies)
        return {
            "hammer": self.hammer.resting(x, y, 0.0, rot),
            "cabinet": Start(CABINET_M, 0.0, (0.0,)),
        }

    def out_m(self, state: State) -> Array:
        """Returns how far the drawer is out, m, (N,)."""
        return -state.objects["cabinet"].joint_pos[:, 0]

    def hammer_inside(self, state: State) -> Array:
        """Returns whether the hammer is where a shut drawer has it, (N,)."""
        pos = state.objects["hammer"].pos
        return (pos[:, 2] > INSIDE_Z_M[0]) & (pos[:, 2] < INSIDE_Z_M[1]) & (pos[:, 1] > INSIDE_Y_M)

    @override
    def success(self, state: State) -> Tensor:
        return self.hammer_inside(state) & (self.out_m(state) < -SHUT_M)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns 0: the zoo rewards success alone."""
        return 0.0 * state.objects["hammer"].pos[:, 0]

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the hammer's pose, the drawer, end effector, and its way to the hammer, (N, 14)."""
        item, hand = state.objects["hammer"], ee_pos(self.arm(state))
        drawer = state.objects["cabinet"].joint_pos
        return concatenate((item.pos, item.rot, drawer, hand, item.pos - hand))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        hand = Hand.of(self, state, rng)
        out = float(self.out_m(state)[0])
        x, y, z = parts.DRAWER_BAR_M
        bar = np.array(CABINET_M) + np.array([x, y - out, z])
        if self._in_drawer(state, out):
            return shut_drawer(hand, bar, np.array([0.0, 1.0, 0.0]), out, 0.0, TRAVEL_M, rng)
        if out < WIDE_M:
            end = bar - np.array([0.0, OPEN_M - out, 0.0])
            return drag(hand, bar, end, 0.0, TRAVEL_M, rng, BAR_OPENING_M)
        return self._store(state, hand, out, rng)

    def _store(self, state: State, hand: Hand, out: float, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way that takes the hammer and lets go of it in the open drawer."""
        item = state.objects["hammer"]
        axis = axis_of(item)[0].numpy()
        grip = along(item, -0.1 * self.length_m)
        turn = grasp_yaw(math.atan2(axis[1], axis[0]), np.pi)  # fingers close across the handle
        way = take(hand, grip, turn, TRAVEL_M, rng)
        middle = (CABINET_M[1] - 0.092 + CABINET_M[1] - 0.105 + 0.01 - out) / 2
        place = np.array([CABINET_M[0], middle, DROP_M])
        lengthwise = math.copysign(np.pi / 2, turn) if abs(turn) > 0.2 else -np.pi / 2
        return [*way, *put(hand.after(way), place, lengthwise, TRAVEL_M, rng, opening_m=0.025)]

    def _in_drawer(self, state: State, out: float) -> bool:
        """Returns whether the hammer lies in the drawer, wherever that is, in a state of one row."""
        pos = state.objects["hammer"].pos[0].numpy()
        x, y, _ = pos - np.array(CABINET_M)
        inside = abs(x) < 0.075 and -0.105 - out < y < 0.055 - out
        return bool(inside and INSIDE_Z_M[0] < pos[2] < INSIDE_Z_M[1])

"""PickPlaceCan, Milk, Bread and Cereal, after robosuite 1.5.1 (``manipulation/pick_place.py``, MIT).

Objects are robosuite's own files; the bins have its sizes and places, and stand on a table: their lower side,
robosuite's z = 0.78 m, is our z = 0. The other three objects are left out, as are the transparent ones that
mark their compartments. An object starts on the bin's floor. The reward is robosuite's shaped one.
"""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, at_least, concatenate, constant, largest, norm, stack, where
from envs.kinematics.waypoints import Waypoint, approach, correction_s, first_miss, miss
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, Rgba, RobotCfg, TableCfg
from envs.state import State
from envs.tasks.arm_at_table import Start, above, heading, point, tip_to_reach, travel_s
from envs.tasks.robosuite.scene import RobosuiteTask, down, panda, pedestal
from envs.tasks.skills.from_above import grasp, set_down
from envs.tasks.tabletop import (
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    distance,
    ee_pos,
    hand_yaw,
    is_held,
    nearness,
)

GROUND_M = 0.78
"""Height of the lower side of robosuite's bins."""

FLOOR_M = 0.04
"""Thickness of a bin's floor."""

BIN_1, BIN_2 = (0.1, -0.25, 0.02), (0.1, 0.28, 0.02)
"""Middle of each bin's floor."""

REACH_REWARD, GRASP_REWARD, LIFT_REWARD, HOVER_REWARD = 0.1, 0.35, 0.5, 0.7
LIFT_TARGET_M = 0.27
"""Height from which an object counts as fully lifted."""

CARRY_M = 0.22
"""Height of an object's lower side on its way, above the walls' 0.12 m."""

GRASP_REACH_M = 0.06
_LIGHT: Rgba = (0.72, 0.55, 0.36, 1.0)
_DARK: Rgba = (0.36, 0.22, 0.13, 1.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Good:
    """An object and its compartment.

    Attributes:
        name: Name of its file.
        corner: Which compartment of the second bin: 0 or 1 along x, and along y.
        bottom_m: Distance of its lower side from its origin.
        top_m: Distance of its upper side.
        width_m: Its width between the fingers, along its own y.
        radius_m: Radius of its circle in the plane (``horizontal_radius_site``).
        grip_m: Where it is gripped, above its origin.
        turns_rad: Turn after which it looks the same to the fingers.
    """

    name: str
    corner: tuple[int, int]
    bottom_m: float
    top_m: float
    width_m: float
    radius_m: float
    grip_m: float
    turns_rad: float


CAN = Good(
    name="can",
    corner=(1, 1),
    bottom_m=0.0403,
    top_m=0.04,
    width_m=0.05,
    radius_m=0.0354,
    grip_m=0.01,
    turns_rad=0.0,
)
MILK = Good(
    name="milk",
    corner=(0, 0),
    bottom_m=0.061,
    top_m=0.083,
    width_m=0.04,
    radius_m=0.0354,
    grip_m=0.035,
    turns_rad=np.pi / 2,
)
BREAD = Good(
    name="bread",
    corner=(1, 0),
    bottom_m=0.0233,
    top_m=0.025,
    width_m=0.04,
    radius_m=0.0424,
    grip_m=0.012,
    turns_rad=np.pi,
)
CEREAL = Good(
    name="cereal",
    corner=(0, 1),
    bottom_m=0.075,
    top_m=0.075,
    width_m=0.03,
    radius_m=0.05,
    grip_m=0.04,
    turns_rad=np.pi,
)


@dataclass(frozen=True, kw_only=True)
class PickPlaceSingle(RobosuiteTask):
    """One object that has to go from the first bin into its compartment of the second.

    Attributes:
        bin_size_m: Length and width of a bin in the success rule (``table_full_size``).
        margin_m: Distance of the object's start from the ends of that size, beside its own radius.
        depth_m: Height range of a success, from the middle of the bin's floor.
        near_most: Success takes ``1 - tanh(10 d)`` below this, for the distance d from hand to object.
    """

    max_episode_steps: ClassVar[int] = 250
    good: ClassVar[Good]
    own_robot: ClassVar[RobotCfg] = panda(-0.5, -0.1, GROUND_M)
    table: ClassVar[TableCfg] = TableCfg(pos=(0.1, 0.0, 0.0), half_size=(0.75, 0.75), height_m=GROUND_M)
    camera: ClassVar[CameraCfg] = dataclasses.replace(FRONT_CAMERA, look_at=(0.0, 0.0, 0.1), fovy_deg=46.0)

    bin_size_m: tuple[float, float] = (0.39, 0.49)
    margin_m: float = 0.05
    depth_m: float = 0.1
    near_most: float = 0.6

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        good = self.good
        item = ObjectCfg(
            name=good.name,
            mjcf=f"robosuite:models/assets/objects/{good.name}.xml",
            mjcf_root="object",
            pos=(BIN_1[0], BIN_1[1], FLOOR_M + good.bottom_m),
        )
        return (
            item,
            _bin("bin1", BIN_1, _LIGHT),
            _bin("bin2", BIN_2, _DARK, divided=True),
            pedestal(self.robot),
        )

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        room = np.array(self.bin_size_m) / 2 - self.margin_m - self.good.radius_m
        x, y = BIN_1[:2] + rng.uniform(-room, room)
        return {self.good.name: Start((x, y, FLOOR_M + self.good.bottom_m), rng.uniform(-np.pi, np.pi))}

    @override
    def success(self, state: State) -> Tensor:
        pos = state.objects[self.good.name].pos
        away = nearness(distance(ee_pos(self.arm(state)), pos), 10.0) < self.near_most
        return self.in_place(state) & away

    @override
    def reward(self, state: State) -> Tensor:
        """Returns robosuite's: the largest of reach, grasp, lift, and hover over the compartment."""
        item, robot = state.objects[self.good.name], self.arm(state)
        reach = REACH_REWARD * nearness(distance(ee_pos(robot), item.pos), 10.0)
        held = is_held(robot, item.pos, GRASP_REACH_M, self.good.width_m, cfg=self.robot)
        high = nearness(at_least(LIFT_TARGET_M - item.pos[:, 2], 0.0), 15.0)
        lift = held * (GRASP_REWARD + (LIFT_REWARD - GRASP_REWARD) * high)
        off = norm(item.pos[:, :2] - constant(self._goal, item.pos))
        near = (HOVER_REWARD - LIFT_REWARD) * nearness(off, 10.0)
        hover = where(self._over_goal(item.pos), LIFT_REWARD + near, lift + near)
        return largest(stack((reach, lift, hover)).T)

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the object's pose, its ways from the hand and to its compartment, and the hand, (N, 15)."""
        item, hand = state.objects[self.good.name], ee_pos(self.arm(state))
        way = constant(self._goal, item.pos) - item.pos[:, :2]
        return concatenate((item.pos, item.rot, item.pos - hand, hand, way))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        good, item = self.good, state.objects[self.good.name]
        hold, grip = GRASP_OPEN_M, GRASP_CLOSED_M
        start, turn = above(point(item), good.grip_m), self.grasp_turn(state)
        # Where the compartment is nearest to the robot, but for the object's own size.
        edge = 0.02 + good.radius_m
        low = np.array(BIN_2[:2]) - (np.array(self.bin_size_m) / 2) * (1 - np.array(good.corner))
        near_corner = low + edge + np.array([rng.uniform(0.0, 0.02), rng.uniform(0.0, 0.02)])
        drop = np.array([*near_corner, CARRY_M + good.bottom_m + good.grip_m])
        tip = tip_to_reach(drop, self.robot)
        # Both ends first miss: the next motion demonstrates the correction.
        noise = first_miss(rng, (0.08, 0.1), seldom_m=0.02)
        aside = rng.normal(0.0, miss(rng, often_m=0.01, seldom_m=0.03), 2)
        lift = np.array([*start[:2], drop[2]])
        near = drop + np.array([*aside, 0.0])
        over = above(point(item), good.top_m + 0.035)
        turn_s = 0.9 + 0.3 * abs(turn - hand_yaw(self.arm(state)))
        return [
            *self.rise(state, 0.22),
            *approach(down(over + noise, turn, hold, turn_s), rng, 0.02),
            *grasp(down(over, turn, hold, 0.3), start, None, down_s=0.6),
            down(lift, turn, grip, 0.6),
            down(near, turn, grip, travel_s(lift, near, 0.5), tip=tip),
            *set_down(
                down(drop, turn, grip, correction_s(aside) + 0.1, tip=tip),
                above(drop, -0.07),
                down_s=0.4,
                settle_s=0.1,
                rise_s=0.4,
                hold_s=0.2,
            ),
        ]

    def grasp_turn(self, state: State) -> float:
        """Returns the turn of the hand that grasps the object, of a state of one row, rad."""
        good = self.good
        turn = heading(state.objects[good.name]) if good.turns_rad else 0.0
        turn = (turn + np.pi / 2) % np.pi - np.pi / 2
        if good.turns_rad and good.turns_rad < np.pi:
            turn = (turn + good.turns_rad / 2) % good.turns_rad - good.turns_rad / 2
        return turn

    def in_place(self, state: State) -> Array:
        """Returns whether the object is in its compartment, wherever the hand is, (N,)."""
        pos = state.objects[self.good.name].pos
        low = (pos[:, 2] > BIN_2[2]) & (pos[:, 2] < BIN_2[2] + self.depth_m)
        return self._over_goal(pos) & low

    @property
    def _goal(self) -> tuple[float, float]:
        """Middle of the compartment."""
        x, y = (BIN_2[axis] + self.bin_size_m[axis] / 4 * (2 * self.good.corner[axis] - 1) for axis in (0, 1))
        return x, y

    def _over_goal(self, pos: Array) -> Array:
        """Returns whether an object is over its compartment, (N,)."""
        off = abs(pos[:, :2] - constant(self._goal, pos))
        return (off[:, 0] < self.bin_size_m[0] / 4) & (off[:, 1] < self.bin_size_m[1] / 4)


def _bin(name: str, pos: tuple[float, float, float], rgba: Rgba, *, divided: bool = False) -> ObjectCfg:
    """Returns a bin of robosuite's ``models/assets/arenas/bins_arena.xml``, divided or not."""
    across, along = (0.21, 0.01, 0.05), (0.01, 0.25, 0.05)
    walls = [(across, (0.0, y, 0.05)) for y in (-0.25, 0.25)] + [(along, (x, 0.0, 0.05)) for x in (-0.2, 0.2)]
    if divided:
        walls += [((0.2, 0.01, 0.05), (0.0, 0.0, 0.05)), (along, (0.0, 0.0, 0.05))]
    geoms = [((0.2, 0.25, 0.02), (0.0, 0.0, 0.0)), *walls]
    return ObjectCfg(
        name=name,
        geoms=tuple(GeomCfg(shape="box", size=size, pos=place, rgba=rgba) for size, place in geoms),
        pos=pos,
        kind="fixed",
    )


class PickPlaceCan(PickPlaceSingle):
    """Put the can into its compartment, the far one on the left."""

    name: ClassVar[str] = "PickPlaceCan"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the can into its compartment of the dark bin",
        "pick up the can and place it in the far left compartment",
        "move the can from the light bin to the dark one",
    )
    good: ClassVar[Good] = CAN


class PickPlaceMilk(PickPlaceSingle):
    """Put the milk carton into its compartment, the near one in the middle."""

    name: ClassVar[str] = "PickPlaceMilk"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the milk carton into its compartment of the dark bin",
        "pick up the milk and place it in the nearest compartment",
        "move the milk from the light bin to the dark one",
    )
    good: ClassVar[Good] = MILK


class PickPlaceBread(PickPlaceSingle):
    """Put the bread into its compartment, the far one in the middle."""

    name: ClassVar[str] = "PickPlaceBread"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the bread into its compartment of the dark bin",
        "pick up the loaf and place it in the far right compartment",
        "move the bread from the light bin to the dark one",
    )
    good: ClassVar[Good] = BREAD


class PickPlaceCereal(PickPlaceSingle):
    """Put the cereal box into its compartment, the near one on the left."""

    name: ClassVar[str] = "PickPlaceCereal"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the cereal box into its compartment of the dark bin",
        "pick up the cereal and place it in the near left compartment",
        "move the cereal box from the light bin to the dark one",
    )
    good: ClassVar[Good] = CEREAL

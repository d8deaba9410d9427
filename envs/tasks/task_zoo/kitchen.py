"""Kitchen, after the robosuite task zoo (``kitchen.py``), and what it shares with MultitaskKitchen.

The zoo's reward is success alone. A pot that would start in the stove's side is moved out of it, as the zoo's
simulator does in its first steps.
"""

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, constant, stack, where
from envs.kinematics.waypoints import Waypoint, grasp_yaw
from envs.rotations import conjugate, rotate
from envs.scenario import GeomCfg, ObjectCfg, RobotCfg, TableCfg
from envs.state import State
from envs.tasks.arm_at_table import Start, heading, point
from envs.tasks.robosuite.scene import panda, pedestal
from envs.tasks.skills.from_above import push, put, take
from envs.tasks.skills.hands import FINGER_HALF_M
from envs.tasks.skills.moves import Hand
from envs.tasks.tabletop import ee_pos, point_on
from envs.tasks.task_zoo import parts
from envs.tasks.task_zoo.parts import INSET_M, TABLE_HEIGHT_M, TABLE_X_M

REGION_HALF_M = (0.05, 0.10, 0.05)
"""How far the pot may be from the middle of the region, which is 22 mm below the table's top."""

REGION_Z_M = -0.022
STOVE_NEAR_M = 0.08
STOVE_Z_M = (0.0, 0.025)
"""The pot is on the stove within this distance of ``on_stove`` along x and y, and at these heights."""

TRAVEL_M = 0.2
"""Height that clears everything, the lever too, with bread in the hand."""

LEVER_Z_M = 0.085
"""Height of the fingers that push the lever: its pad's middle is at 75 mm."""

HIDDEN_Z_M = -0.02
"""Height of a flame that is off: inside the table."""

NOTED_M = 0.01
"""Height of the marker that says that the stove has been on."""

_UNSEEN = GeomCfg(shape="sphere", size=(0.001,), visible=False)


@dataclass(frozen=True, kw_only=True, slots=True)
class Layout:
    """Where things are.

    Attributes:
        stove: The stove, m.
        button: The lever.
        region: The serving region.
        on_stove: Where the pot is on the stove.
        bread_half_m: Half sizes of the bread.
    """

    stove: tuple[float, float]
    button: tuple[float, float]
    region: tuple[float, float]
    on_stove: tuple[float, float]
    bread_half_m: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class KitchenTask(parts.ZooTask):
    """A task with a pot, bread, a stove with a lever, and a region where food is served.

    Attributes:
        bread_x_m: Range of the bread along x.
        bread_y_m: Likewise along y.
        pot_x_m: Range of the pot along x.
        pot_y_m: Likewise along y.
        pot_yaw_rad: Range of its turn.
    """

    own_robot: ClassVar[RobotCfg] = panda(-0.66, table_height_m=TABLE_HEIGHT_M)
    table: ClassVar[TableCfg] = TableCfg(
        pos=(-0.135, 0.0, 0.0), half_size=(0.435, 0.4), height_m=TABLE_HEIGHT_M
    )
    has_reward: ClassVar[bool] = False
    layout: ClassVar[Layout]

    bread_x_m: tuple[float, float]
    bread_y_m: tuple[float, float]
    pot_x_m: tuple[float, float]
    pot_y_m: tuple[float, float]
    pot_yaw_rad: tuple[float, float] = (-0.1, 0.1)

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        (sx, sy), (bx, by), (rx, ry) = self.layout.stove, self.layout.button, self.layout.region
        fixed = (
            replace(parts.stove(), pos=(sx, sy, 0.02 - INSET_M)),
            replace(parts.button(), pos=(bx, by, 0.02 - INSET_M), rot=(0.0, 0.0, 0.0, 1.0)),
            replace(parts.serving_region(), pos=(rx, ry, 5e-4)),
        )
        moving = (parts.block("bread", self.layout.bread_half_m, parts.BREAD, ("pot",)), parts.pot())
        return (*fixed, *moving, parts.flame(), pedestal(self.robot))

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        bread = (rng.uniform(*self.bread_x_m), rng.uniform(*self.bread_y_m), self.layout.bread_half_m[2])
        x, y, yaw = rng.uniform(*self.pot_x_m), rng.uniform(*self.pot_y_m), rng.uniform(*self.pot_yaw_rad)
        lever = self.first_lever(rng)
        return {
            "bread": Start(bread, -np.pi / 2),
            "pot": Start((x, self.pot_room(x, y, yaw), parts.POT_BOTTOM_M), yaw),
            "button": Start((*self.layout.button, 0.02 - INSET_M), np.pi, (lever,)),
            "flame": Start(self._flame(lever >= 0.0)),
        }

    @abstractmethod
    def first_lever(self, rng: np.random.Generator) -> float:
        """Draws the lever's start, rad."""

    def pot_room(self, x: float, y: float, yaw: float) -> float:
        """Returns the pot's y, m, after it has been moved out of what it would touch."""
        del x
        return min(y, self.layout.stove[1] - 0.095 - self.pot_reach_m(yaw) - 1e-3)

    @staticmethod
    def pot_reach_m(yaw: float) -> float:
        """Returns how far a pot of that turn, rad, reaches along y, m."""
        (x, y), turn = parts.POT_HALF_M, abs(yaw)
        return y * float(np.cos(turn)) + x * float(np.sin(turn))

    def _flame(self, lit: bool) -> tuple[float, float, float]:
        high = 0.02 - INSET_M + parts.STOVE_TOP_M + 1.5e-3
        return (*self.layout.stove, high if lit else HIDDEN_Z_M)

    def stove_on(self, state: State) -> Array:
        """Returns whether the stove is on, (N,)."""
        return state.objects["button"].joint_pos[:, 0] >= 0.0

    def bread_in_pot(self, state: State) -> Array:
        """Returns whether bread and pot touch, (N,): by their places where a simulator does not say so."""
        bread, inside = state.objects["bread"], self.bread_inside(state)
        return inside if bread.touched is None else bread.touched[:, 0] > 0.5

    def pot_in_region(self, state: State) -> Array:
        """Returns whether the pot is in the serving region, (N,)."""
        pot = state.objects["pot"].pos
        off = abs(pot - constant((*self.layout.region, REGION_Z_M), pot))
        return (off < constant(REGION_HALF_M, pot)).all(-1)

    def pot_on_stove(self, state: State) -> Array:
        """Returns whether the pot is on the stove, (N,)."""
        pot = state.objects["pot"].pos
        near = (abs(pot[:, :2] - constant(self.layout.on_stove, pot)) < STOVE_NEAR_M).all(-1)
        return near & (pot[:, 2] > STOVE_Z_M[0]) & (pot[:, 2] < STOVE_Z_M[1])

    @override
    def memory(self, state: State) -> dict[str, tuple[Tensor, Tensor]]:
        flame = state.objects["flame"]
        lit, dark = (constant(self._flame(on), flame.pos) for on in (True, False))
        return {"flame": (where(self.stove_on(state)[:, None], lit, dark), flame.rot)}

    @override
    def reward(self, state: State) -> Tensor:
        """Returns 0: the zoo rewards success alone."""
        return 0.0 * state.objects["pot"].pos[:, 0]

    @override
    def observe(self, state: State) -> Tensor:
        """Returns poses of bread and pot, the lever, end effector, and ways between them, (N, 24)."""
        bread, pot, hand = state.objects["bread"], state.objects["pot"], ee_pos(self.arm(state))
        lever = state.objects["button"].joint_pos
        ways = (bread.pos - hand, pot.pos - bread.pos)
        return concatenate((bread.pos, bread.rot, pot.pos, pot.rot, lever, hand, *ways))

    def flip(self, state: State, on: bool, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way that pushes the lever over."""
        hand = Hand.of(self, state, rng)
        x, y = self.layout.button
        side = -1.0 if on else 1.0
        behind = np.array([x, y + side * 0.075, LEVER_Z_M])
        # The pad leans over by 15 mm; half of it and two fingers are between its middle and the hand's.
        end = np.array([x, y + side * (0.0125 + 2 * FINGER_HALF_M[1] - 0.014), LEVER_Z_M])
        return push(hand, behind, end, 0.0, TRAVEL_M, rng)

    def fill(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way that takes the bread and drops it into the pot."""
        hand, bread, pot = Hand.of(self, state, rng), state.objects["bread"], state.objects["pot"]
        grip, turn = point(bread), heading(bread)
        grip[2] += 0.006
        turn = grasp_yaw(turn, np.pi)  # across its narrow sides
        narrow = turn + np.pi / 2 if self.layout.bread_half_m[0] < self.layout.bread_half_m[1] else turn
        narrow = grasp_yaw(narrow, np.pi)
        way = take(hand, grip, narrow, TRAVEL_M, rng)
        over = point(pot) + np.array([0.0, 0.0, 0.1])
        along = grasp_yaw(heading(pot), np.pi)
        return [*way, *put(hand.after(way), over, along, TRAVEL_M, rng, opening_m=0.03)]

    def carry(
        self,
        state: State,
        to: tuple[float, float],
        floor_m: float,
        rng: np.random.Generator,
        side: float = -1.0,
    ) -> list[Waypoint]:
        """Returns the way that carries the pot by a handle to a place.

        Args:
            state: A state of one row.
            to: The place, m.
            floor_m: Its height.
            rng: Varies the way.
            side: Sign of the handle's y in the pot's frame.
        """
        hand, pot = Hand.of(self, state, rng), state.objects["pot"]
        turn = grasp_yaw(heading(pot), np.pi)
        x, y, z = parts.POT_HANDLE_M
        grip = point_on(pot, (x, side * y, z))[0].numpy().copy()
        way = take(hand, grip, turn, TRAVEL_M, rng)
        place = np.array([to[0], to[1] + side * y, floor_m + parts.POT_BOTTOM_M + z + 0.004])
        return [*way, *put(hand.after(way), place, 0.0, TRAVEL_M, rng)]

    def serve(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way that pushes the pot into the region from behind."""
        hand = Hand.of(self, state, rng)
        pot, turn = point(state.objects["pot"]), grasp_yaw(heading(state.objects["pot"]), np.pi)
        gone = self.layout.region[0] - 0.015 - pot[0]
        behind = np.array([pot[0] - parts.POT_HALF_M[0] - FINGER_HALF_M[0] - 0.03, pot[1], 0.03])
        end = behind + np.array([gone + 0.03, 0.0, 0.0])
        return push(hand, behind, end, turn, TRAVEL_M, rng)

    def bread_inside(self, state: State) -> Array:
        """Returns whether the bread is inside the pot, by their places, (N,)."""
        bread, pot = state.objects["bread"], state.objects["pot"]
        local = rotate(conjugate(pot.rot), bread.pos - pot.pos)
        x, y = parts.POT_INNER_M
        return (abs(local[:, 0]) < x) & (abs(local[:, 1]) < y) & (local[:, 2] < 0.05)


KITCHEN = Layout(
    stove=(TABLE_X_M + 0.23, 0.095),
    button=(TABLE_X_M + 0.06, 0.10),
    region=(TABLE_X_M + 0.345, -0.15),
    on_stove=(TABLE_X_M + 0.23, 0.095),
    bread_half_m=(0.015, 0.025, 0.02),
)


@dataclass(frozen=True, kw_only=True)
class Kitchen(KitchenTask):
    """Turn the stove on, cook bread in the pot, turn the stove off and serve the pot.

    Success asks that the stove has been on, and is off; the expert also puts the pot on it meanwhile.
    """

    name: ClassVar[str] = "Kitchen"
    instructions: ClassVar[tuple[str, ...]] = (
        "turn on the stove, cook the bread in the pot on it, turn off the stove and serve the pot",
        "heat the bread in the pot on the stove, then bring the pot to the red plate with the stove off",
        "cook the bread and serve it on the red plate",
    )
    max_episode_steps: ClassVar[int] = 1000
    layout: ClassVar[Layout] = KITCHEN

    bread_x_m: tuple[float, float] = (TABLE_X_M + 0.05, TABLE_X_M + 0.08)
    bread_y_m: tuple[float, float] = (-0.18, -0.12)
    pot_x_m: tuple[float, float] = (TABLE_X_M + 0.175, TABLE_X_M + 0.18)
    pot_y_m: tuple[float, float] = (-0.15, -0.13)

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (*super().objects, ObjectCfg(name="was_on", geoms=(_UNSEEN,), kind="marker"))

    @override
    def first_lever(self, rng: np.random.Generator) -> float:
        del rng
        return -parts.LEVER_RAD

    def was_on(self, state: State) -> Array:
        """Returns whether the stove is on or has been, (N,)."""
        return (state.objects["was_on"].pos[:, 2] > NOTED_M / 2) | self.stove_on(state)

    @override
    def memory(self, state: State) -> dict[str, tuple[Tensor, Tensor]]:
        mark = state.objects["was_on"]
        x, y, z = mark.pos.T
        noted = where(self.was_on(state), NOTED_M, 0.0 * z)
        return super().memory(state) | {"was_on": (stack((x, y, noted)).T, mark.rot)}

    @override
    def success(self, state: State) -> Tensor:
        cooked = self.was_on(state) & ~self.stove_on(state) & self.bread_in_pot(state)
        return cooked & self.pot_in_region(state)

    @override
    def observe(self, state: State) -> Tensor:
        """Returns :meth:`KitchenTask.observe`, and whether the stove has been on, (N, 25)."""
        known = super().observe(state)
        return concatenate((known, known[:, :1] * 0.0 + self.was_on(state)[:, None]))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        if not bool(self.was_on(state)[0]):
            return self.flip(state, True, rng)
        if not bool(self.bread_inside(state)[0]):
            return self.fill(state, rng)
        on = bool(self.stove_on(state)[0])
        if on and not bool(self.pot_on_stove(state)[0]):
            return self.carry(state, self.layout.on_stove, 0.0175, rng)
        if on:
            return self.flip(state, False, rng)
        return self.carry(state, self.layout.region, 0.0, rng, side=1.0)

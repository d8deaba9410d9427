"""MultitaskKitchen, after the robosuite task zoo (``multitask_kitchen.py``): nine goals in one kitchen.

The zoo pulls an open drawer out in an episode's first steps, and lets bread that starts in the pot fall into
it; here both are there at the start.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate
from envs.kinematics.waypoints import Waypoint
from envs.scenario import CameraCfg, ObjectCfg
from envs.state import State
from envs.tasks.arm_at_table import Start
from envs.tasks.entry_classes import classes_of
from envs.tasks.skills.from_above import shut_drawer
from envs.tasks.skills.moves import Hand
from envs.tasks.task_zoo import parts
from envs.tasks.task_zoo.catalogue import HORIZON, Entry, entries
from envs.tasks.task_zoo.kitchen import TRAVEL_M, KitchenTask, Layout
from envs.tasks.task_zoo.parts import INSET_M, SHUT_M, TABLE_X_M

CABINET_M = (TABLE_X_M + 0.15, -0.30, 0.03 - INSET_M)
"""The cabinet; it is turned round, so that its drawer opens to positive y."""

OPEN_M = 0.10
TRAVEL_OF_DRAWER_M = 0.105
DRAWER_FRONT_M = 0.115
"""Distance of the shut drawer's front from the cabinet's origin."""

FILLED_M = 0.0075
"""Height of the pot's floor above its origin."""

_POSTS = tuple(parts.box((0.012, 0.012, 0.064), (x, -0.07, 0.065), parts.CERAMIC) for x in (-0.102, 0.102))


@dataclass(frozen=True, kw_only=True)
class MultitaskKitchen(KitchenTask):
    """Shut the drawer, turn the stove on, put bread in the pot, bring the pot somewhere: parts of it.

    Attributes:
        filled_x_m: Range along x of bread that starts in the pot.
        filled_y_m: Likewise along y.
        lever_on_rad: Range of the lever of a stove that starts on.
    """

    max_episode_steps: ClassVar[int] = HORIZON
    entry: ClassVar[Entry]
    layout: ClassVar[Layout] = Layout(
        stove=(TABLE_X_M + 0.23, 0.18),
        button=(TABLE_X_M + 0.06, 0.20),
        region=(TABLE_X_M + 0.35, -0.02),
        on_stove=(0.05, 0.20),
        bread_half_m=(0.015, 0.023, 0.02),
    )

    camera: ClassVar[CameraCfg] = replace(parts.ZooTask.camera, look_at=(-0.1, -0.04, 0.05), fovy_deg=40.0)

    bread_x_m: tuple[float, float] = (TABLE_X_M - 0.05, TABLE_X_M - 0.01)
    bread_y_m: tuple[float, float] = (0.04, 0.08)
    pot_x_m: tuple[float, float] = (TABLE_X_M + 0.21, TABLE_X_M + 0.25)
    pot_y_m: tuple[float, float] = (-0.02, 0.02)
    filled_x_m: tuple[float, float] = (TABLE_X_M + 0.22, TABLE_X_M + 0.24)
    filled_y_m: tuple[float, float] = (-0.01, 0.01)
    lever_on_rad: tuple[float, float] = (0.1, 0.3)

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        chest = parts.cabinet(TRAVEL_OF_DRAWER_M, parts.CERAMIC, floor_m=-0.045)
        chest = replace(chest, geoms=(*chest.geoms, *_POSTS), pos=CABINET_M, rot=(0.0, 0.0, 0.0, 1.0))
        return (*super().objects, chest)

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        drawn = super().starts(rng)
        inside = (rng.uniform(*self.filled_x_m), rng.uniform(*self.filled_y_m))
        if self.entry.starts_filled:
            x, y, z = drawn["pot"].pos
            room = np.array(parts.POT_INNER_M) - np.array((0.026, 0.02))  # the bread may be turned a little
            middle = np.array((x, y))
            at = np.clip(inside, middle - room, middle + room)
            drawn["bread"] = Start((*at, z + FILLED_M + self.layout.bread_half_m[2]), -np.pi / 2)
        drawer = -OPEN_M if self.entry.starts_open else 0.0
        return drawn | {"cabinet": Start(CABINET_M, np.pi, (drawer,))}

    @override
    def first_lever(self, rng: np.random.Generator) -> float:
        on = rng.uniform(*self.lever_on_rad)
        return on if self.entry.starts_on else -parts.LEVER_RAD

    @override
    def pot_room(self, x: float, y: float, yaw: float) -> float:
        y = super().pot_room(x, y, yaw)
        if not self.entry.starts_open:
            return y
        front = CABINET_M[1] + DRAWER_FRONT_M + OPEN_M
        return max(y, front + self.pot_reach_m(yaw) + 1e-3)

    def drawer_shut(self, state: State) -> Array:
        """Returns whether the drawer is shut, (N,)."""
        return state.objects["cabinet"].joint_pos[:, 0] > SHUT_M

    @override
    def success(self, state: State) -> Tensor:
        there = self.pot_on_stove(state) if self.entry.place == "stove" else self.pot_in_region(state)
        done = there & self.bread_in_pot(state)
        if self.entry.closes:
            done = done & self.drawer_shut(state)
        if self.entry.stove is not None:
            done = done & (self.stove_on(state) == self.entry.stove)
        return done

    @override
    def observe(self, state: State) -> Tensor:
        """Returns :meth:`KitchenTask.observe`, and how far the drawer is out, m, (N, 25)."""
        return concatenate((super().observe(state), state.objects["cabinet"].joint_pos))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        if self.entry.closes and not bool(self.drawer_shut(state)[0]):
            return self._close(state, rng)
        if self.entry.stove is not None and bool(self.stove_on(state)[0]) != self.entry.stove:
            return self.flip(state, self.entry.stove, rng)
        if not bool(self.bread_inside(state)[0]):
            return self.fill(state, rng)
        if self.entry.place == "stove":
            x, y = self.layout.stove
            # By the far handle: the drawer's is beside the near one.
            return self.carry(state, (x + 0.01, y + 0.01), 0.0175, rng, side=1.0)
        return self.serve(state, rng)

    def _close(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way that pushes the drawer shut by its handle's bar."""
        x, y, z = parts.DRAWER_BAR_M
        out = -float(state.objects["cabinet"].joint_pos[0, 0])
        bar = np.array([CABINET_M[0] - x, CABINET_M[1] - y + out, CABINET_M[2] + z])
        ahead = np.array([0.0, -1.0, 0.0])
        return shut_drawer(Hand.of(self, state, rng), bar, ahead, out, 0.0, TRAVEL_M, rng)


__getattr__ = classes_of(
    MultitaskKitchen, __name__, lambda: entries().values(), lambda entry: entry.instructions
)

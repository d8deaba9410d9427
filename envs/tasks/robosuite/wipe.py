"""Wipe, after robosuite 1.5.1 (``manipulation/wipe.py``, ``arenas/wipe_arena.py``, ``wiping_gripper.xml``).

Sizes, the line of dirt and the rule are robosuite's (MIT). Its wiper gives way: pressed down, its lower side
is below the table's top, and it wipes markers between that plane and 20 mm over it. Ours is hard, so that a
gap of 2 mm counts too. Rewards for contact and penalties for force are left out: a state has no forces.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, constant, norm, stack, where
from envs.kinematics.waypoints import Waypoint
from envs.robots.franka import FRANKA_STICK
from envs.rotations import conjugate, rotate
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, Rgba, RobotCfg, SiteCfg, TableCfg
from envs.state import State
from envs.tasks.arm_at_table import Start
from envs.tasks.robosuite.scene import BASE_HEIGHT_M, HOME, RobosuiteTask, pedestal
from envs.tasks.skills.from_above import wipe
from envs.tasks.skills.moves import Hand, at_height
from envs.tasks.tabletop import FRONT_CAMERA, ee_pos, nearness

TABLE_HEIGHT_M = 0.9
WIPER_M = (0.025, 0.06, 0.015)
"""Half sizes of the wiper in the hand's frame."""

NUM_MARKERS = 100
MARKER_RADIUS_M = 0.02
SPACING_M, BEND_RAD, BENDS = 0.005, 0.5, 0.3
"""Distance of markers on the line, spread of its bends, and share of markers at which it bends."""

COVERAGE = 0.6
"""Share of the table where markers are."""

ABOVE_M, GAP_M = 0.02, 2e-3
"""How far a wiped marker is over the wiper's lower side at most, and how far it may be under it."""

WIPED_Z_M = -0.02
"""Height of a marker that has been wiped off: inside the table."""

SHOWN_Z_M = 1e-3
TRAVEL_M = 0.08
"""Height at which the expert travels. It wipes at the table's top: pressed below it, the wiper tips over."""

EVERY = 6
"""Markers from one waypoint of the expert to the next."""

_DIRT: Rgba = (0.25, 0.16, 0.08, 1.0)
_GREY: Rgba = (0.25, 0.25, 0.25, 1.0)

_WIPER = replace(
    FRANKA_STICK,
    name="franka_wiper",
    tool=(GeomCfg(shape="box", size=WIPER_M, pos=(0.0, 0.0, WIPER_M[2]), rgba=_GREY, mass_kg=0.03),),
    sites=(SiteCfg(name="wiper", body="tool", pos=(0.0, 0.0, 2 * WIPER_M[2])),),
    ee_site="wiper",
    pos=(-0.41, 0.0, BASE_HEIGHT_M - TABLE_HEIGHT_M),
).with_home(HOME[:7])
"""The arm with robosuite's wiper in place of its hand, ``base_xpos_offset`` from a table 0.5 m long."""

MARKERS = tuple(f"dirt_{index:02d}" for index in range(NUM_MARKERS))


@dataclass(frozen=True, kw_only=True)
class Wipe(RobosuiteTask):
    """Wipe a line of dirt off the table.

    Attributes:
        coverage: Share of the table's length and width where dirt is.
    """

    name: ClassVar[str] = "Wipe"
    instructions: ClassVar[tuple[str, ...]] = (
        "wipe the dirt off the table",
        "clean the table with the wiper",
        "wipe away the whole line of dirt",
    )
    max_episode_steps: ClassVar[int] = 500
    own_robot: ClassVar[RobotCfg] = _WIPER
    table: ClassVar[TableCfg] = TableCfg(pos=(0.15, 0.0, 0.0), half_size=(0.25, 0.4), height_m=TABLE_HEIGHT_M)
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, look_at=(0.1, 0.0, 0.05), fovy_deg=38.0)

    coverage: float = COVERAGE

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        disc = GeomCfg(shape="cylinder", size=(MARKER_RADIUS_M, 1e-3), rgba=_DIRT)
        dirt = (
            ObjectCfg(name=name, geoms=(disc,), pos=(0.15, 0.0, SHOWN_Z_M), kind="marker") for name in MARKERS
        )
        return (*dirt, pedestal(self.robot))

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        middle, half = np.array(self.table.pos[:2]), np.array(self.table.half_size)
        most = half * self.coverage - MARKER_RADIUS_M
        place, turn, drawn = rng.uniform(-most, most), rng.uniform(-np.pi, np.pi), {}
        for name in MARKERS:
            drawn[name] = Start((*(middle + place), SHOWN_Z_M))
            if rng.uniform() > 1.0 - BENDS:
                turn += rng.normal(0.0, BEND_RAD)
            step = SPACING_M * np.array([np.sin(turn), np.cos(turn)])
            while (np.abs(place + step) >= most).any():
                turn += rng.normal(0.0, BEND_RAD)
                step = SPACING_M * np.array([np.sin(turn), np.cos(turn)])
            place = place + step
        return drawn

    def dirt(self, state: State) -> Array:
        """Returns where markers are, m, (N, 100, 3)."""
        places = [state.objects[name].pos for name in MARKERS]
        return np.stack(places, 1) if isinstance(places[0], np.ndarray) else stack(places).transpose(0, 1)

    def left(self, state: State) -> Array:
        """Returns which markers are left, (N, 100)."""
        return self.dirt(state)[..., 2] > WIPED_Z_M / 2

    @override
    def memory(self, state: State) -> dict[str, tuple[Tensor, Tensor]]:
        arm, places = self.arm(state), self.dirt(state)
        assert arm.ee_rot is not None, "a simulator gives every robot's end effector"
        off = places - ee_pos(arm)[:, None]
        off[..., 2] = off[..., 2] - SHOWN_Z_M  # a marker is in the table's top
        local = rotate(conjugate(arm.ee_rot)[:, None], off)  # z points down, out of the wiper
        under = (abs(local[..., :2]) < constant(WIPER_M[:2], local)).all(-1)
        wiped = under & (local[..., 2] > -ABOVE_M) & (local[..., 2] < GAP_M)
        wiped = wiped & (places[..., 2] > WIPED_Z_M / 2)
        moved = {}
        for index in np.flatnonzero(np.asarray(wiped.any(0).tolist())).tolist():
            mark = state.objects[MARKERS[index]]
            x, y, z = mark.pos.T
            down_z = where(wiped[:, index], WIPED_Z_M, z)
            moved[MARKERS[index]] = (stack((x, y, down_z)).T, mark.rot)
        return moved

    @override
    def success(self, state: State) -> Tensor:
        finite = norm(ee_pos(self.arm(state))) < np.inf
        return ~self.left(state).any(-1) & finite

    @override
    def reward(self, state: State) -> Tensor:
        """Returns 0.8 of the share that is wiped off, and up to 0.1 for a wiper near the rest of the dirt."""
        share, centre, _ = self._summary(state)
        near = nearness(norm(centre - ee_pos(self.arm(state))))
        return 0.8 * share + 0.1 * near

    @override
    def observe(self, state: State) -> Tensor:
        """Returns share wiped, radius and middle of the rest, wiper, and the way between them, (N, 11)."""
        share, centre, radius = self._summary(state)
        tip = ee_pos(self.arm(state))
        return concatenate((share[:, None], radius[:, None], centre, tip, centre - tip))

    def _summary(self, state: State) -> tuple[Array, Array, Array]:
        """Returns the share wiped off (N,), the middle of the rest (N, 3), and its radius (N,)."""
        places, left = self.dirt(state), self.left(state)
        weight = left * constant((1.0,), places)
        count = weight.sum(-1)
        centre = (places * weight[..., None]).sum(1) / (count + 1e-9)[:, None]
        off = norm(places - centre[:, None]) * weight
        radius = off.max(-1) if isinstance(off, np.ndarray) else off.amax(-1)
        return 1.0 - count / NUM_MARKERS, centre, radius

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        hand, places = Hand.of(self, state, rng), self.dirt(state)[0].numpy()[self.left(state)[0].numpy()]
        if not len(places):  # the last step of its plan wiped the last marker
            return [hand.to(hand.pos, hand.yaw, 0.0)]
        line = [at_height(place, 0.0) for place in (*places[:-1:EVERY], places[-1])]
        begin, end = (float(np.linalg.norm((line[index] - hand.pos)[:2])) for index in (0, -1))
        return wipe(hand, line if begin <= end else line[::-1], 0.0, TRAVEL_M, rng)

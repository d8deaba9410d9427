"""TwoArmTransport, after robosuite 1.5.1 (``environments/manipulation/two_arm_transport.py``, MIT).

Bins, lid and hammer have the sizes of ``models/objects/composite/``. A bin, 26 kg in robosuite, does not move
here, and its floor is an object of its own, for the rule is about touching it. robosuite has no dense reward
for the task; ours is how near hammer and cube are to their bins.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, largest
from envs.kinematics.waypoints import Waypoint, first_miss, grasp_yaw
from envs.rotations import from_matrix
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, Rgba, RobotCfg, TableCfg
from envs.state import State
from envs.tasks.arm_at_table import Start, above, heading, point, travel_s
from envs.tasks.arms import Hand, downward, pointing
from envs.tasks.arms_planner import Phase
from envs.tasks.robosuite.hammer import Hammer
from envs.tasks.robosuite.handing_over import FROM_RIGHT, hand_over, pick_up
from envs.tasks.robosuite.scene import TABLE_HEIGHT_M, panda
from envs.tasks.robosuite.two_arms import TwoArms, opposed
from envs.tasks.skills.from_above import grasp, set_down
from envs.tasks.tabletop import (
    DENSITY_KG_M3,
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    TABLETOP_LOOKS,
    distance,
    ee_pos,
    flat_distance,
    nearness,
)

TABLE_Y_M = 0.45
"""Distance of each table's middle from the origin, 3/8 of 1.2 m."""

BIN_M, BIN_HEIGHT_M, WALL_M = 0.3, 0.15, 0.01
BIN_X_M = 0.2
LID_M, LID_HANDLE_M = (0.15, 0.15, 0.005), (0.01, 0.04, 0.015)
LID_HALF_HEIGHT_M = LID_M[2] + LID_HANDLE_M[2]
GRIP_LID_M = LID_HALF_HEIGHT_M - LID_HANDLE_M[2]
"""Height of the handle's middle above the lid's."""

TRASH_HALF_M = 0.02
PAYLOAD = Hammer(radius_m=0.015, length_m=0.2, density=150.0, head_density_ratio=1.5, friction=4.0)
MEETING_M = np.array([0.0, -0.05, 0.4])
"""Where the left hand hands the hammer over, above the bins."""

CARRY_Z_M = 0.32
LIFTED_M = 0.2
_DARK: Rgba = (0.3, 0.18, 0.1, 1.0)
_GLASS: Rgba = (1.0, 1.0, 1.0, 0.3)
_RED: Rgba = (0.45, 0.12, 0.08, 1.0)
_GAP_M = 5e-4
_LEG_M = 0.04
"""Half the side of a table's leg."""

_TOUCHED_Z_M = 0.08
"""Height of a middle below which something in a bin is at its floor, where a simulator says no touch."""


def _second(table: TableCfg) -> ObjectCfg:
    """Returns a table like the scene's own, on legs that are only seen."""
    wood = (*TABLETOP_LOOKS.materials["table"].rgb, 1.0)
    half = (*table.half_size, table.thickness_m / 2)
    board = GeomCfg(shape="box", size=half, pos=(0.0, 0.0, -half[2]), rgba=wood)
    high = (table.height_m - table.thickness_m) / 2
    legs = (
        GeomCfg(
            shape="box",
            size=(_LEG_M, _LEG_M, high),
            pos=(x * (half[0] - 2 * _LEG_M), y * (half[1] - 2 * _LEG_M), -table.thickness_m - high),
            rgba=wood,
            collides=False,
        )
        for x in (-1, 1)
        for y in (-1, 1)
    )
    return ObjectCfg(name="table_right", geoms=(board, *legs), pos=(0.0, TABLE_Y_M, 0.0), kind="fixed")


def _floor(name: str) -> ObjectCfg:
    half = (BIN_M - WALL_M) / 2
    geom = GeomCfg(shape="box", size=(half, half, WALL_M / 2), rgba=_DARK)
    return ObjectCfg(name=name, geoms=(geom,), pos=(0.0, 0.0, WALL_M / 2), kind="fixed")


def _walls(name: str) -> ObjectCfg:
    off, side = (BIN_M - WALL_M) / 2, BIN_M / 2
    across, along = (WALL_M / 2, side, BIN_HEIGHT_M / 2), (side, WALL_M / 2, BIN_HEIGHT_M / 2)
    places = [(across, (sign * off, 0.0, 0.0)) for sign in (-1.0, 1.0)]
    places += [(along, (0.0, sign * off, 0.0)) for sign in (-1.0, 1.0)]
    geoms = tuple(GeomCfg(shape="box", size=size, pos=pos, rgba=_GLASS) for size, pos in places)
    return ObjectCfg(name=name, geoms=geoms, pos=(0.0, 0.0, BIN_HEIGHT_M / 2), kind="fixed")


def _lid() -> ObjectCfg:
    top = GeomCfg(
        shape="box",
        size=LID_M,
        pos=(0.0, 0.0, -LID_HALF_HEIGHT_M + LID_M[2]),
        rgba=_GLASS,
        mass_kg=8.0 * math.prod(LID_M) * 250.0,
    )
    handle = GeomCfg(
        shape="box",
        size=LID_HANDLE_M,
        pos=(0.0, 0.0, GRIP_LID_M),
        rgba=_DARK,
        mass_kg=8.0 * math.prod(LID_HANDLE_M) * 500.0,
    )
    return ObjectCfg(name="lid", geoms=(top, handle), pos=(BIN_X_M, -TABLE_Y_M, 0.2))


@dataclass(frozen=True, kw_only=True)
class TwoArmTransport(TwoArms):
    """Bring the hammer from the covered bin to the other table, and the cube there into the trash.

    Attributes:
        place_m: Largest distance of a bin from its place along x and y.
        payload_half_rad: Largest turn of the hammer from the direction of the other table.
        trash_half_rad: Largest turn of the cube.
    """

    name: ClassVar[str] = "TwoArmTransport"
    instructions: ClassVar[tuple[str, ...]] = (
        "bring the hammer from the covered bin to the other table and the cube into the trash bin",
        "clear the cube out of the bin on the right and put the hammer there",
        "take off the lid, hand the hammer over and put it into the emptied bin",
    )
    max_episode_steps: ClassVar[int] = 700
    own_robots: ClassVar[tuple[RobotCfg, ...]] = opposed(panda(0.0), 0.81)
    table: ClassVar[TableCfg] = TableCfg(
        pos=(0.0, -TABLE_Y_M, 0.0), half_size=(0.4, 0.15), height_m=TABLE_HEIGHT_M
    )
    camera: ClassVar[CameraCfg] = replace(
        FRONT_CAMERA, pos=(1.5, 0.0, 1.1), look_at=(0.0, 0.0, 0.1), fovy_deg=62.0
    )

    place_m: float = 0.005
    payload_half_rad: float = math.pi / 6
    trash_half_rad: float = 0.3 * math.pi

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        cube = GeomCfg(
            shape="box", size=(TRASH_HALF_M,) * 3, rgba=_RED, mass_kg=8.0 * TRASH_HALF_M**3 * DENSITY_KG_M3
        )
        names = ("start", "target", "trash")
        return (
            _second(self.table),
            *(_floor(f"{name}_floor") for name in names),
            *(_walls(f"{name}_walls") for name in names),
            _lid(),
            PAYLOAD.as_object("payload", feels=("target_floor",)),
            ObjectCfg(name="trash", geoms=(cube,), pos=(0.0, 0.0, 0.05), feels=("trash_floor",)),
            *self.pedestals,
        )

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        middles = ((BIN_X_M, -TABLE_Y_M), (-BIN_X_M, TABLE_Y_M), (BIN_X_M, TABLE_Y_M))
        drawn: dict[str, Start] = {}
        places = {}
        for name, middle in zip(("start", "target", "trash"), middles, strict=True):
            x, y = np.array(middle) + rng.uniform(-self.place_m, self.place_m, 2)
            places[name] = (x, y)
            drawn[f"{name}_floor"] = Start((x, y, WALL_M / 2))
            drawn[f"{name}_walls"] = Start((x, y, BIN_HEIGHT_M / 2))
        turn = math.pi / 2 + rng.uniform(-self.payload_half_rad, self.payload_half_rad)
        side = (-1.0, 1.0)[int(rng.integers(2))]  # its face is to the robot's left, whichever way it points
        axis = np.array([math.cos(turn), side * math.sin(turn), 0.0])
        face = side * np.array([-axis[1], axis[0], 0.0])
        rot = from_matrix(np.stack([face, np.cross(axis, face), axis], axis=1))
        x, y = np.array(places["start"]) + _off_walls(face, axis)
        drawn["payload"] = PAYLOAD.resting(x, y, WALL_M, rot)
        drawn["lid"] = Start((*places["start"], BIN_HEIGHT_M + LID_HALF_HEIGHT_M))
        yaw = rng.uniform(-self.trash_half_rad, self.trash_half_rad)
        drawn["trash"] = Start((*places["target"], WALL_M + TRASH_HALF_M), yaw)
        return drawn

    @override
    def success(self, state: State) -> Tensor:
        return self._at_floor(state, "payload", "target") & self._at_floor(state, "trash", "trash")

    @override
    def reward(self, state: State) -> Tensor:
        """Returns how near the hammer and the cube are to the floors of their bins, in [0, 1)."""
        parts = (("payload", "target"), ("trash", "trash"))
        near = [
            nearness(distance(state.objects[name].pos, state.objects[f"{bin_}_floor"].pos), 2.0)
            for name, bin_ in parts
        ]
        return 0.495 * (near[0] + near[1])

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the poses of hammer, cube and lid, the bins, and the end effectors, (N, 36)."""
        items = [state.objects[name] for name in ("payload", "trash", "lid")]
        bins = [state.objects[f"{name}_floor"].pos for name in ("start", "target", "trash")]
        hands = [ee_pos(state.robots[robot.name]) for robot in self.robots]
        poses = [part for item in items for part in (item.pos, item.rot)]
        return concatenate((*poses, *bins, *hands))

    @override
    def phases(self, state: State, rng: np.random.Generator) -> list[Phase]:
        payload, left, right = state.objects["payload"], self.hand(state, 0), self.hand(state, 1)
        high = float(payload.pos[0, 2]) > LIFTED_M
        if high and bool(self._holds(state, 1)[0]):
            return [{right.name: self._deliver(state, right)}]
        if high and bool(self._holds(state, 0)[0]):
            return hand_over(left, right, payload, PAYLOAD.length_m, rng)
        if bool(self._at_floor(state, "payload", "target")[0]):
            return [{right.name: self._clear(state, right, rng)}]
        phases: list[Phase] = []
        lid, start = state.objects["lid"], state.objects["start_floor"]
        covered = float(flat_distance(lid.pos, start.pos)[0]) < BIN_M / 2
        clears = not bool(self._at_floor(state, "trash", "trash")[0])
        first = {left.name: self._uncover(state, left, rng)} if covered else {}
        first |= {right.name: self._clear(state, right, rng)} if clears else {}
        if first:
            phases.append(first)
        picks, met = pick_up(left, payload, PAYLOAD.length_m, rng, slope=0.0)
        high_up = replace(picks[-1], pos=above(picks[-2].pos, 0.35), duration_s=1.0)
        passing = MEETING_M + rng.uniform(-0.02, 0.02, 3)
        carried = left.to(passing, met, GRASP_CLOSED_M, 2.0, hold_s=0.3)
        waits = passing + np.array([0.0, 0.25, 0.1])
        comes = right.to(waits, right.nearer(pointing(FROM_RIGHT, (1.0, 0.0, 0.0))), GRASP_OPEN_M, 1.5)
        return [*phases, {left.name: [*picks[:-1], high_up, carried], right.name: [comes]}]

    def _uncover(self, state: State, hand: Hand, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way to put the lid beside its bin."""
        lid = point(state.objects["lid"])
        grip = above(lid, GRIP_LID_M)
        aside = np.array([-BIN_X_M + rng.uniform(0.0, 0.02), grip[1], LID_HALF_HEIGHT_M + GRIP_LID_M + 0.002])
        return _moved(hand, grip, aside, hand.nearer(downward(heading(state.objects["lid"]))), rng)

    def _clear(self, state: State, hand: Hand, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way to drop the cube into the trash."""
        trash = state.objects["trash"]
        rot = hand.nearer(downward(grasp_yaw(heading(trash))))
        spot = above(point(state.objects["trash_floor"]), 0.05)
        return _moved(hand, point(trash), spot, rot, rng)

    def _deliver(self, state: State, hand: Hand) -> list[Waypoint]:
        """Returns the way of the held hammer into its bin."""
        off = hand.pos - point(state.objects["payload"])
        spot = above(point(state.objects["target_floor"]) + off, 0.045)
        over = np.array([*spot[:2], MEETING_M[2]])
        rot = hand.nearer(downward(0.0))  # near its base, fingers that reach ahead strain the wrist
        come = hand.to(over, rot, GRASP_CLOSED_M, travel_s(hand.pos, over, 1.5), hold_s=0.1)
        return set_down(come, spot, down_s=1.0, settle_s=0.1, rise_m=float(over[2] - spot[2]), rise_s=0.8)

    def _holds(self, state: State, index: int) -> Array:
        hand = ee_pos(state.robots[self.robots[index].name])
        grip = PAYLOAD.nearest(state.objects["payload"], hand, 2 * PAYLOAD.head_m)
        return self.grasps(state, index, grip, 2 * PAYLOAD.radius_m)

    def _at_floor(self, state: State, name: str, bin_name: str) -> Array:
        """Returns whether something touches the floor of a bin, (N,)."""
        item, floor = state.objects[name], state.objects[f"{bin_name}_floor"]
        if item.touched is not None:
            return item.touched[:, 0] > 0.5
        off = abs(item.pos - floor.pos)
        return (largest(off[:, :2]) < BIN_M / 2 - WALL_M) & (off[:, 2] < _TOUCHED_Z_M)


def _off_walls(face: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Returns by how much a hammer is moved, m, (2,), so that its head, turned far, is not inside a wall.

    In robosuite the simulator pushes it out, by up to 3 mm.
    """
    h, end = PAYLOAD.head_m, PAYLOAD.length_m / 2
    corners = np.array([x * face + z * axis for x in (-3.2 * h, 3.2 * h) for z in (end, end + 2 * h)])
    most = BIN_M / 2 - WALL_M - _GAP_M
    return -np.maximum(corners.max(0) - most, 0.0)[:2] - np.minimum(corners.min(0) + most, 0.0)[:2]


def _moved(
    hand: Hand, grip: np.ndarray, spot: np.ndarray, rot: np.ndarray, rng: np.random.Generator
) -> list[Waypoint]:
    """Returns the way to grasp something from above and to let go of it elsewhere."""
    aside = first_miss(rng, often_m=0.005, seldom_m=0.015)
    over, there = above(grip, 0.12) + aside, np.array([*spot[:2], CARRY_Z_M])
    lifted = np.array([*grip[:2], CARRY_Z_M])
    wide, shut = GRASP_OPEN_M, GRASP_CLOSED_M
    return [
        hand.to(np.array([*over[:2], CARRY_Z_M]), rot, wide, travel_s(hand.pos, over, 1.0)),
        hand.to(over, rot, wide, 0.5),
        *grasp(hand.to(above(grip, 0.08), rot, wide, 0.3, hold_s=0.1), grip, None),
        hand.to(lifted, rot, shut, 1.0),
        *set_down(
            hand.to(there, rot, shut, travel_s(lifted, there, 0.7), hold_s=0.1),
            spot,
            down_s=1.0,
            settle_s=0.1,
            rise_m=CARRY_Z_M - float(spot[2]),
            rise_s=0.7,
        ),
    ]

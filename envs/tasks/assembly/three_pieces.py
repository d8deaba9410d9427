"""ThreePieceAssembly, after MimicGen (arXiv:2310.17596): a block into a frame, and one into the first.

MimicGen's pieces are patterns of cubes; ours are a square frame, a block with a groove, and a block with a
tongue. Its rule: each of both is within 2 cm of the one below along x and y, let go of, and the second one is
at its height, within 2 cm.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate
from envs.kinematics.waypoints import Waypoint, grasp_yaw
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, Rgba, Vec3
from envs.state import EntityState, State
from envs.tasks.arm_at_table import heading, point
from envs.tasks.assembly.ranges import Range, RangedTask, Ranges
from envs.tasks.robosuite.scene import pedestal
from envs.tasks.skills.from_above import take
from envs.tasks.skills.held import Held, Pose
from envs.tasks.skills.insertion import DOWN, Insertion, insertion_way
from envs.tasks.skills.moves import Hand
from envs.tasks.tabletop import FRONT_CAMERA, distance, ee_pos, flat_distance, is_held, nearness

NEAR_M = 0.02
"""Largest distance of a piece from where it belongs."""

FRAME_M, HOLE_M, FRAME_Z_M, FLOOR_M = 0.05, 0.027, 0.015, 0.003
"""Half sides of the frame and of its hole, half its height, and half the thickness of its floor."""

FOOT_M, FOOT_Z_M, CHEEK_M, CHEEK_Z_M = 0.025, 0.02, 0.006, 0.015
"""Half the side and height of the first block's foot; half the thickness and height of its cheeks."""

TONGUE_M: Vec3 = (0.02, 0.0105, 0.013)
HEAD_M: Vec3 = (0.022, 0.02, 0.015)
"""Half sizes of the second block's tongue and head."""

LOW_Z_M = FOOT_Z_M
"""Height of the first block's origin, the middle of its foot, above what carries it."""

SECOND_Z_M = 2 * TONGUE_M[2]
"""Height of the second block's origin, the lower face of its head, above what carries it."""

GRIP_M = (FOOT_Z_M + CHEEK_Z_M + 0.008, HEAD_M[2] + 0.004)
"""Height of the grip site above the origin of each block."""

WIDTH_M = (2 * FOOT_M, 2 * HEAD_M[1])
ABOVE_M = (2 * FLOOR_M + LOW_Z_M, 2 * FLOOR_M + 2 * FOOT_Z_M + SECOND_Z_M)
"""Height of each block's origin above the frame's lower face when all is assembled."""

GRASP_REACH_M, OVER_M, TRAVEL_M = 0.02, 0.09, 0.2
OPENING_M = (0.035, 0.03)
EXACT_M, EXACT_RAD = 0.0015, 0.03
_WOOD: Rgba = (0.55, 0.3, 0.15, 1.0)
_RED: Rgba = (0.65, 0.15, 0.1, 1.0)
_YELLOW: Rgba = (0.85, 0.65, 0.15, 1.0)
_DENSITY = 400.0
_BLOCKS = ("piece_1", "piece_2")


def pieces() -> tuple[ObjectCfg, ...]:
    """Returns frame, block with a groove along x, and block with a tongue along x."""
    bar = (FRAME_M - HOLE_M) / 2
    walls: list[tuple[Vec3, Vec3]] = [((FRAME_M, FRAME_M, FLOOR_M), (0.0, 0.0, FLOOR_M - FRAME_Z_M))]
    for sign in (-1.0, 1.0):
        walls.append(((bar, FRAME_M, FRAME_Z_M), (sign * (HOLE_M + bar), 0.0, 0.0)))
        walls.append(((HOLE_M, bar, FRAME_Z_M), (0.0, sign * (HOLE_M + bar), 0.0)))
    base = ObjectCfg(
        name="base",
        geoms=tuple(GeomCfg.box(half, pos, _WOOD, 1200.0) for half, pos in walls),
        pos=(0.0, 0.0, FRAME_Z_M),
    )
    cheek = (FOOT_M, CHEEK_M, CHEEK_Z_M)
    first = [GeomCfg.box((FOOT_M, FOOT_M, FOOT_Z_M), (0.0, 0.0, 0.0), _RED, _DENSITY)]
    first += [
        GeomCfg.box(cheek, (0.0, sign * (FOOT_M - CHEEK_M), FOOT_Z_M + CHEEK_Z_M), _RED, _DENSITY)
        for sign in (-1.0, 1.0)
    ]
    second = (
        GeomCfg.box(TONGUE_M, (0.0, 0.0, -TONGUE_M[2]), _YELLOW, _DENSITY),
        GeomCfg.box(HEAD_M, (0.0, 0.0, HEAD_M[2]), _YELLOW, _DENSITY),
    )
    return (
        base,
        ObjectCfg(name="piece_1", geoms=tuple(first), pos=(0.0, 0.0, LOW_Z_M)),
        ObjectCfg(name="piece_2", geoms=second, pos=(0.0, 0.0, SECOND_Z_M)),
    )


_ANYWHERE = ((-0.22, 0.22), (-0.22, 0.22))
_QUARTER = (np.pi / 2, np.pi / 2)
_HALF_TURN = (0.0, np.pi)


@dataclass(frozen=True, kw_only=True)
class ThreePieceAssembly(RangedTask):
    """Put the first block into the frame, and the second one into the first."""

    name: ClassVar[str] = "ThreePieceAssembly"
    instructions: ClassVar[tuple[str, ...]] = (
        "assemble the three pieces",
        "put the red block into the wooden frame and the yellow block into the red one",
        "insert the red piece into the base, then the yellow piece on top of it",
    )
    max_episode_steps: ClassVar[int] = 500
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, look_at=(-0.02, 0.0, 0.06), fovy_deg=32.0)
    radii_m: ClassVar[dict[str, float]] = {"base": 0.075, "piece_1": 0.045, "piece_2": 0.045}
    ranges: ClassVar[Ranges] = {
        "D0": {
            "base": Range((0.0, 0.0), (0.0, 0.0)),
            "piece_1": Range(*_ANYWHERE, _QUARTER),
            "piece_2": Range(*_ANYWHERE, _QUARTER),
        },
        "D1": {
            "base": Range(*_ANYWHERE),
            "piece_1": Range(*_ANYWHERE, _QUARTER),
            "piece_2": Range(*_ANYWHERE, _QUARTER),
        },
        "D2": {
            "base": Range(*_ANYWHERE, (-np.pi / 4, np.pi / 4)),
            "piece_1": Range(*_ANYWHERE, _HALF_TURN),
            "piece_2": Range(*_ANYWHERE, _HALF_TURN),
        },
    }

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (*pieces(), pedestal(self.robot))

    def held(self, state: State, index: int) -> Array:
        """Returns whether the hand holds the first or the second block, (N,)."""
        item: EntityState = state.objects[_BLOCKS[index]]
        grip = item.pos + 0.0
        grip[:, 2] = grip[:, 2] + GRIP_M[index]
        return is_held(self.arm(state), grip, GRASP_REACH_M, WIDTH_M[index], cfg=self.robot)

    def first_done(self, state: State) -> Array:
        """Returns whether the first block is in the frame, and let go of, (N,)."""
        base, first = state.objects["base"].pos, state.objects["piece_1"].pos
        return (flat_distance(first, base) < NEAR_M) & ~self.held(state, 0)

    @override
    def success(self, state: State) -> Tensor:
        base, first, second = (state.objects[name].pos for name in ("base", *_BLOCKS))
        height = second[:, 2] - base[:, 2] + FRAME_Z_M - ABOVE_M[1]
        on = (flat_distance(second, first) < NEAR_M) & (abs(height) < NEAR_M)
        return self.first_done(state) & on & ~self.held(state, 1)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns 0.45 for the first block in the frame, and as much for how near the next one is."""
        base, first, second = (state.objects[name].pos for name in ("base", *_BLOCKS))
        hand, done = ee_pos(self.arm(state)), self.first_done(state)
        at_first = (
            nearness(distance(hand, first)) + self.held(state, 0) + nearness(flat_distance(first, base))
        )
        at_second = (
            nearness(distance(hand, second)) + self.held(state, 1) + nearness(flat_distance(second, first))
        )
        return 0.15 * (at_first * ~done + (3.0 + at_second) * done)

    @override
    def observe(self, state: State) -> Tensor:
        """Returns poses of the three pieces, end effector, and ways between them, (N, 33)."""
        base, first, second = (state.objects[name] for name in ("base", *_BLOCKS))
        hand = ee_pos(self.arm(state))
        poses = [part for item in (base, first, second) for part in (item.pos, item.rot)]
        return concatenate((*poses, hand, first.pos - hand, second.pos - hand, first.pos - base.pos))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        index = int(bool(self._placed(state)[0]) and not bool(self.held(state, 0)[0]))
        item = state.objects[_BLOCKS[index]]
        if bool(self.held(state, index)[0]) and item.pos[0, 2] > 0.06:
            return insertion_way(Held.of(self, state, _BLOCKS[index]), self._place(state, index), rng)
        grip = point(item) + np.array([0.0, 0.0, GRIP_M[index]])
        return take(Hand.of(self, state, rng), grip, grasp_yaw(heading(item), np.pi), TRAVEL_M, rng)

    @override
    def foreseen(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the first grasp, and the way to the frame."""
        way = self.expert(state, rng)
        base = point(state.objects["base"]) + np.array([0.0, 0.0, 0.1])
        return [*way, replace(way[-1], pos=base, yaw=0.0), *way]

    def _placed(self, state: State) -> Array:
        """Returns whether the first block is down in the frame, held or not, (N,)."""
        base, first = state.objects["base"].pos, state.objects["piece_1"].pos
        low = abs(first[:, 2] - base[:, 2] + FRAME_Z_M - ABOVE_M[0]) < 0.006
        return low & (flat_distance(first, base) < NEAR_M)

    def _place(self, state: State, index: int) -> Insertion:
        """Returns where a block goes."""
        base, item = state.objects["base"], state.objects[_BLOCKS[index]]
        symmetry, onto = ((np.pi / 2, base), (np.pi, state.objects["piece_1"]))[index]
        turn, now = heading(onto), heading(item)
        turn += symmetry * round((now - turn) / symmetry)
        middle = point(onto)
        middle[2] = float(base.pos[0, 2]) - FRAME_Z_M + ABOVE_M[index] + 0.004
        return Insertion(
            goal=Pose.level(middle, turn),
            into=DOWN,
            back_m=OVER_M,
            exact_m=EXACT_M,
            exact_rad=EXACT_RAD,
            opening_m=OPENING_M[index],
        )

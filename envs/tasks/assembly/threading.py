"""Threading, after MimicGen (arXiv:2310.17596): a needle goes through a ring on a stand.

Needle and ring have about MimicGen's sizes. Its rule: the middle of the needle is nearer to the middle of the
ring than the ring's inner radius.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate
from envs.kinematics.waypoints import Waypoint, first_miss
from envs.rotations import conjugate, rotate, wrapped
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, Quat, Rgba, Vec3
from envs.state import State
from envs.tasks.arm_at_table import EASY_REACH_M, above, heading
from envs.tasks.assembly.ranges import Range, RangedTask, Ranges
from envs.tasks.robosuite.scene import down, pedestal
from envs.tasks.skills.from_above import grasp
from envs.tasks.skills.held import Held, Pose
from envs.tasks.skills.insertion import Insertion, insertion_way
from envs.tasks.tabletop import (
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    distance,
    ee_pos,
    hand_yaw,
    is_held,
    nearness,
    point_on,
)

NEEDLE_HALF_M, NEEDLE_THICK_M, HANDLE_M = 0.06, 0.005, 0.02
"""Half the needle's length and thickness, and half the side of the cube at its end."""

GRIP_M = NEEDLE_HALF_M + HANDLE_M
"""Distance of the cube's middle from the needle's."""

RING_INNER_M, RING_WALL_M, RING_DEEP_M = 0.018, 0.003, 0.005
RING_Z_M = 0.15
GRASP_REACH_M = 0.03
READY_M = NEEDLE_HALF_M + 0.025
"""Distance of the needle's middle from the ring at which the expert lines it up."""

EXACT_M, EXACT_RAD = 0.003, 0.03
FAR_RAD_M = 30.0
"""Turn of the hand that is as hard as reaching a metre too far, rad."""

_GREY: Rgba = (0.35, 0.35, 0.38, 1.0)
_BLUE: Rgba = (0.12, 0.25, 0.65, 1.0)
_YELLOW: Rgba = (0.9, 0.7, 0.1, 1.0)
_SMOOTH: Vec3 = (0.3, 0.005, 0.0001)
_SIDES = 8


def needle() -> ObjectCfg:
    """Returns the needle: it points along x, and its handle is behind."""
    bar = (NEEDLE_HALF_M, NEEDLE_THICK_M, NEEDLE_THICK_M)
    geoms = (
        GeomCfg.box(bar, (0.0, 0.0, 0.0), _BLUE, 300.0, friction=_SMOOTH),
        GeomCfg.box((HANDLE_M, HANDLE_M, HANDLE_M), (-GRIP_M, 0.0, 0.0), _BLUE, 300.0),
    )
    return ObjectCfg(name="needle", geoms=geoms, pos=(0.0, 0.0, HANDLE_M))


def tripod() -> ObjectCfg:
    """Returns the stand, with the ring's axis along x."""
    middle = RING_INNER_M + RING_WALL_M
    half_side = middle * math.tan(math.pi / _SIDES) + 0.001
    ring = []
    for side in range(_SIDES):
        angle = 2.0 * math.pi * side / _SIDES
        rot: Quat = (math.cos(angle / 2.0), math.sin(angle / 2.0), 0.0, 0.0)
        pos = (0.0, -middle * math.sin(angle), RING_Z_M + middle * math.cos(angle))
        ring.append(
            GeomCfg.box((RING_DEEP_M, half_side, RING_WALL_M), pos, _YELLOW, 500.0, rot=rot, friction=_SMOOTH)
        )
    post = (RING_Z_M - RING_INNER_M - 2 * RING_WALL_M - 0.01) / 2.0
    stand = (
        GeomCfg.box((0.05, 0.05, 0.005), (0.0, 0.0, 0.005), _GREY, 2000.0),
        GeomCfg.box((0.005, 0.005, post), (0.0, 0.0, 0.01 + post), _GREY, 1000.0),
    )
    return ObjectCfg(name="tripod", geoms=(*stand, *ring))


@dataclass(frozen=True, kw_only=True)
class Threading(RangedTask):
    """Take the needle by its handle and put it through the ring."""

    name: ClassVar[str] = "Threading"
    instructions: ClassVar[tuple[str, ...]] = (
        "thread the needle through the ring",
        "pick up the blue needle and insert it into the yellow ring",
        "put the needle through the hole on the stand",
    )
    max_episode_steps: ClassVar[int] = 300
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, look_at=(-0.03, 0.0, 0.1), fovy_deg=34.0)
    radii_m: ClassVar[dict[str, float]] = {"needle": 0.1, "tripod": 0.07}
    # MimicGen's needle points along negative y of its frame, and the ring's axis is along y of its own.
    ranges: ClassVar[Ranges] = {
        "D0": {
            "needle": Range((-0.2, -0.05), (0.15, 0.25), (-7 * np.pi / 6, -5 * np.pi / 6)),
            "tripod": Range((0.0, 0.0), (-0.15, -0.15), (np.pi, np.pi)),
        },
        "D1": {
            "needle": Range((-0.2, 0.05), (0.15, 0.25), (-5 * np.pi / 3, -np.pi / 3)),
            "tripod": Range((-0.1, 0.15), (-0.2, -0.1), (2 * np.pi / 3, 4 * np.pi / 3)),
        },
        "D2": {
            "needle": Range((-0.2, 0.05), (-0.25, -0.15), (-5 * np.pi / 3, -np.pi / 3)),
            "tripod": Range((-0.1, 0.15), (0.1, 0.2), (-np.pi / 3, np.pi / 3)),
        },
    }

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (needle(), tripod(), pedestal(self.robot))

    def ring(self, state: State) -> Array:
        """Returns the middle of the ring, m, (N, 3)."""
        return point_on(state.objects["tripod"], (0.0, 0.0, RING_Z_M))

    def handle(self, state: State) -> Array:
        """Returns the middle of the needle's handle, m, (N, 3)."""
        return point_on(state.objects["needle"], (-GRIP_M, 0.0, 0.0))

    @override
    def success(self, state: State) -> Tensor:
        return distance(state.objects["needle"].pos, self.ring(state)) < RING_INNER_M

    @override
    def reward(self, state: State) -> Tensor:
        """Returns a third each for a near hand, a held handle, and the needle's way to the ring."""
        hand, handle = ee_pos(self.arm(state)), self.handle(state)
        held = is_held(self.arm(state), handle, GRASP_REACH_M, 2 * HANDLE_M, cfg=self.robot)
        placed = nearness(distance(state.objects["needle"].pos, self.ring(state)))
        return 0.33 * (nearness(distance(hand, handle)) + held * (1.0 + placed))

    @override
    def observe(self, state: State) -> Tensor:
        """Returns poses of needle and stand, end effector, its way to the handle, needle in ring, (N, 23)."""
        item, stand, hand = state.objects["needle"], state.objects["tripod"], ee_pos(self.arm(state))
        inside = rotate(conjugate(stand.rot), item.pos - self.ring(state))
        return concatenate(
            (item.pos, item.rot, stand.pos, stand.rot, hand, self.handle(state) - hand, inside)
        )

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        handle = self.handle(state)
        held = is_held(self.arm(state), handle, GRASP_REACH_M, 2 * HANDLE_M, cfg=self.robot)
        if bool(held[0]) and handle[0, 2] > 2 * HANDLE_M:
            return self._thread(state, rng)
        start, turn = handle[0].numpy().copy(), self._turns(state)[0]
        noise = first_miss(rng, (0.06, 0.09))
        turn_s = 0.7 + 0.4 * abs(turn - hand_yaw(self.arm(state)))
        return [
            *self.rise(state, 0.25),
            *grasp(down(start + noise, turn, GRASP_OPEN_M, turn_s), start, rng),
            down(above(start, RING_Z_M + 0.03), turn, GRASP_CLOSED_M, 0.8, hold_s=0.1),
        ]

    @override
    def foreseen(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the grasp, and where the hand holds the needle in the ring."""
        _, line = self._turns(state)
        ring = self.ring(state)[0].numpy()
        behind = ring - GRIP_M * np.array([np.cos(line), np.sin(line), 0.0])
        turn = float((line + np.pi / 2) % np.pi - np.pi / 2)
        return [*self.expert(state, rng), down(behind, turn, GRASP_CLOSED_M, 1.0)]

    def _turns(self, state: State) -> tuple[float, float]:
        """Returns the turn of a hand that grasps the handle, and the direction through the ring, rad.

        Of both ways to hold it, and both through the ring, the hand takes those that turn it least.
        """
        pointing = heading(state.objects["needle"])
        grasps = [float(wrapped(pointing + grasp)) for grasp in (0.0, np.pi)]
        ways = [(turn, *self._line(state, turn)) for turn in grasps]
        turn, line, _ = min(ways, key=lambda way: max(abs(way[0]), way[2]))
        return turn, line

    def _line(self, state: State, turn: float) -> tuple[float, float]:
        """Returns the direction through the ring, rad, of a hand of that turn, and how hard it is.

        It is the one that turns the hand least, in rad, unless the hand would be far from the robot.
        """
        pointing, axis = heading(state.objects["needle"]), heading(state.objects["tripod"])
        ring, base = self.ring(state)[0].numpy(), np.array(self.robot.pos)
        ways = []
        for line in (axis, axis + np.pi):
            behind = ring - (READY_M + GRIP_M) * np.array([np.cos(line), np.sin(line), 0.0])
            far = max(0.0, float(np.linalg.norm((behind - base)[:2])) - EASY_REACH_M)
            ways.append((line, abs(turn + wrapped(line - pointing)) + FAR_RAD_M * far))
        return min(ways, key=lambda way: way[1])

    def _thread(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way of a held needle to before the ring, a correction, or through it."""
        line, _ = self._line(state, hand_yaw(self.arm(state)))
        held, into = Held.of(self, state, "needle"), np.array([np.cos(line), np.sin(line), 0.0])
        where = Insertion(
            goal=Pose(self.ring(state)[0].numpy().copy(), held.pose.pointing(into).rot),
            into=into,
            back_m=READY_M,
            exact_m=EXACT_M,
            exact_rad=EXACT_RAD,
        )
        return insertion_way(held, where, rng)

"""MugCleanup, after MimicGen (arXiv:2310.17596): a mug goes into a drawer, which is opened and shut.

The mug is ours; the cabinet is that of the robosuite task zoo (MIT), which MimicGen's is made after.
MimicGen's rule: the mug touches the drawer's floor and stands upright, and the drawer is shut. It has the
ranges D0 and D1.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate
from envs.kinematics.waypoints import Waypoint, grasp_yaw
from envs.rotations import conjugate, rotate, uprightness
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, Quat, Rgba, Vec3
from envs.state import State
from envs.tasks.arm_at_table import heading, point
from envs.tasks.assembly.ranges import Range, RangedTask, Ranges
from envs.tasks.robosuite.scene import pedestal
from envs.tasks.skills.from_above import drag, put, shut_drawer, take
from envs.tasks.skills.moves import Hand
from envs.tasks.tabletop import FRONT_CAMERA, ee_pos, point_on
from envs.tasks.task_zoo import parts

RADIUS_M, WALL_M, HEIGHT_M = 0.032, 0.0025, 0.056
"""Outer radius of the mug, half the thickness of its walls, and its height."""

TRAVEL_OF_DRAWER_M, OPEN_M, WIDE_M = 0.135, 0.13, 0.12
"""The drawer's travel, how far the expert pulls it, and from where a mug fits in."""

UPRIGHT = 1e-3
"""Largest distance of the vertical part of the mug's axis from 1."""

FLOOR_M = parts.DRAWER_FLOOR_M
GRIP_M = 0.018
"""Height of the grip site above the mug's middle."""

BAR_OPENING_M = 0.022
RELEASE_OPENING_M = 0.037
TRAVEL_M = 0.25
MOST_TURN_RAD = 2.0
"""Largest turn of the hand that the wrist's range allows."""

_SIDES = 12
_MUG: Rgba = (0.2, 0.45, 0.65, 1.0)
_DENSITY = 700.0


def mug() -> ObjectCfg:
    """Returns the mug, whose handle points along its x axis; its origin is in its middle."""
    half = HEIGHT_M / 2
    middle = RADIUS_M - WALL_M
    side = middle * math.tan(math.pi / _SIDES) + 5e-4
    geoms = [
        GeomCfg(
            shape="cylinder",
            size=(RADIUS_M - 2 * WALL_M, WALL_M),
            pos=(0.0, 0.0, WALL_M - half),
            rgba=_MUG,
            mass_kg=math.pi * middle**2 * 2 * WALL_M * _DENSITY,
        )
    ]
    for index in range(_SIDES):
        angle = 2.0 * math.pi * index / _SIDES
        rot: Quat = (math.cos(angle / 2.0), 0.0, 0.0, math.sin(angle / 2.0))
        geoms.append(
            _wall((WALL_M, side, half), (middle * math.cos(angle), middle * math.sin(angle), 0.0), rot)
        )
    reach = RADIUS_M + 0.012
    geoms += [_wall((0.012, 0.004, 0.003), (reach, 0.0, z)) for z in (-0.014, 0.014)]
    geoms.append(_wall((0.003, 0.004, 0.017), (reach + 0.009, 0.0, 0.0)))
    return ObjectCfg(name="mug", geoms=tuple(geoms), pos=(0.0, 0.0, half), feels=("cabinet/drawer",))


def _wall(half: Vec3, pos: Vec3, rot: Quat = (1.0, 0.0, 0.0, 0.0)) -> GeomCfg:
    mass = 8.0 * math.prod(half) * _DENSITY
    return GeomCfg(shape="box", size=half, pos=pos, rot=rot, rgba=_MUG, mass_kg=mass)


@dataclass(frozen=True, kw_only=True)
class MugCleanup(RangedTask):
    """Pull the drawer open, stand the mug in it, and push it shut."""

    name: ClassVar[str] = "MugCleanup"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the mug in the drawer and close the drawer",
        "open the drawer, stand the mug inside and shut it",
        "clean up the mug into the drawer",
    )
    max_episode_steps: ClassVar[int] = 600
    camera: ClassVar[CameraCfg] = replace(
        FRONT_CAMERA, pos=(1.1, 0.0, 0.85), look_at=(-0.05, 0.06, 0.05), fovy_deg=40.0
    )
    radii_m: ClassVar[dict[str, float]] = {"mug": 0.05, "cabinet": 0.17}
    joints: ClassVar[dict[str, tuple[float, ...]]] = {"cabinet": (0.0,)}
    ranges: ClassVar[Ranges] = {
        "D0": {
            "cabinet": Range((0.0, 0.0), (0.3, 0.3)),
            "mug": Range((-0.15, 0.15), (-0.25, -0.1), (0.0, 2 * np.pi)),
        },
        "D1": {
            "cabinet": Range((-0.15, 0.05), (0.25, 0.35), (-np.pi / 6, np.pi / 6)),
            "mug": Range((-0.25, 0.15), (-0.3, -0.15), (0.0, 2 * np.pi)),
        },
    }

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        chest = replace(parts.cabinet(TRAVEL_OF_DRAWER_M, parts.RED_WOOD), pos=(0.0, 0.0, 0.01))
        return (mug(), chest, pedestal(self.robot))

    def out_m(self, state: State) -> Array:
        """Returns how far the drawer is out, m, (N,)."""
        return -state.objects["cabinet"].joint_pos[:, 0]

    def mug_inside(self, state: State) -> Array:
        """Returns whether the mug stands on the drawer's floor, (N,)."""
        item, chest = state.objects["mug"], state.objects["cabinet"]
        local = rotate(conjugate(chest.rot), item.pos - chest.pos)
        y = local[:, 1] + self.out_m(state)
        inside = (abs(local[:, 0]) < 0.064) & (y > -0.095) & (y < 0.047)
        low = abs(local[:, 2] - FLOOR_M - HEIGHT_M / 2) < 0.01
        here = inside & low
        return here if item.touched is None else here & (item.touched[:, 0] > 0.5)

    @override
    def success(self, state: State) -> Tensor:
        upright = 1.0 - uprightness(state.objects["mug"].rot) < UPRIGHT
        return self.mug_inside(state) & upright & (self.out_m(state) < -parts.SHUT_M)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns 0.3 for an open drawer while the mug is outside, 0.6 to 0.9 for one that shuts on it."""
        share = (self.out_m(state) / OPEN_M).clip(0.0, 1.0)
        inside = self.mug_inside(state)
        return 0.3 * share * ~inside + (0.9 - 0.3 * share) * inside

    @override
    def observe(self, state: State) -> Tensor:
        """Returns poses of mug and cabinet, the drawer, end effector, and its way to the mug, (N, 21)."""
        item, chest, hand = state.objects["mug"], state.objects["cabinet"], ee_pos(self.arm(state))
        return concatenate((item.pos, item.rot, chest.pos, chest.rot, chest.joint_pos, hand, item.pos - hand))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        hand = Hand.of(self, state, rng)
        out, turn = float(self.out_m(state)[0]), heading(state.objects["cabinet"])
        x, y, z = parts.DRAWER_BAR_M
        bar = self._at(state, (x, y - out, z))
        ahead = self._at(state, (x, y - out + 1.0, z)) - bar
        if bool(self.mug_inside(state)[0]):
            return shut_drawer(hand, bar, ahead, out, turn, TRAVEL_M, rng)
        if out < WIDE_M:
            end = bar - (OPEN_M - out) * ahead
            return drag(hand, bar, end, turn, TRAVEL_M, rng, BAR_OPENING_M)
        item = state.objects["mug"]
        grip = point(item) + np.array([0.0, 0.0, GRIP_M])
        across = grasp_yaw(heading(item), np.pi)  # fingers close beside the handle
        way = take(hand, grip, across, TRAVEL_M, rng, opening_m=0.04)
        middle = self._at(state, (0.0, (-0.092 - 0.095 - out) / 2, FLOOR_M + HEIGHT_M / 2 + GRIP_M + 0.003))
        # The mug's handle goes along the drawer's front, where there is room.
        ways = [each for each in (turn, turn + np.pi, turn - np.pi) if abs(each) < MOST_TURN_RAD]
        turned = min(ways, key=lambda each: abs(each - across))
        return [*way, *put(hand.after(way), middle, turned, TRAVEL_M, rng, opening_m=RELEASE_OPENING_M)]

    def _at(self, state: State, place: Vec3) -> np.ndarray:
        """Returns a point of the cabinet's frame in the world, m, (3,), in a state of one row."""
        return point_on(state.objects["cabinet"], place)[0].numpy().copy()

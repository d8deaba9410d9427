"""PegInsertionSide, after ManiSkill 3 (``tabletop/peg_insertion_side.py``).

ManiSkill draws the size of the peg, and where the hole is in its box, for each environment. Here they are
options of the scene, by default in the middle of its ranges: half lengths of 0.085 to 0.125 m, radii of 0.015
to 0.025 m, and a hole up to half their difference off the middle. The reward is ManiSkill's; its grasp test
reads contact forces, which a state does not have.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, constant, largest, norm, stack, tanh
from envs.core.errors import ConfigError
from envs.kinematics.waypoints import Waypoint, first_miss
from envs.rotations import conjugate, rotate
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, Rgba
from envs.state import EntityState, State
from envs.tasks.arm_at_table import ArmAtTable, Start, heading, point, way
from envs.tasks.maniskill.pegs import on_peg, peg
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
)

GRIP_M = -0.06
"""Where the peg is gripped: distance from its middle towards its head."""

GRASP_REACH_M = 0.03
LINED_UP_M = 0.01
"""Distance of the peg's axis from the hole's from which the reward counts the insertion."""

READY_M = 0.02
"""Gap between the peg's head and the box where the expert lines it up."""

EXACT_M, EXACT_RAD = 1e-3, 0.016
"""Errors of the peg's pose at which the expert begins to insert it."""

AHEAD_M = 0.005
"""How far past the middle of the box the expert brings the peg's head."""

_ORANGE: Rgba = (0.84, 0.17, 0.09, 1.0)
_WHITE: Rgba = (0.85, 0.92, 0.94, 1.0)
_SAND: Rgba = (1.0, 0.64, 0.25, 1.0)


@dataclass(frozen=True, kw_only=True)
class PegInsertionSide(ArmAtTable):
    """Take a peg and put its orange end into the hole in the side of a box.

    Attributes:
        peg_half_length_m: Half the length of the peg, and of each side of the box.
        peg_radius_m: Half the side of the peg's section.
        clearance_m: How much wider than the peg the hole is, to each side.
        hole_offset_m: Place of the hole's axis against the box's middle, along y and z of the box.
        peg_low_m: Least x and y of the peg's start.
        peg_high_m: Largest x and y of the peg's start.
        peg_yaw_rad: Largest turn of the peg from pointing along y.
        box_low_m: Least x and y of the box.
        box_high_m: Largest x and y of the box.
        box_yaw_rad: Largest turn of the hole from pointing along y.
        depth_tolerance_m: How far before the middle of the box, along the hole, the peg's head may be.
    """

    name: ClassVar[str] = "PegInsertionSide"
    instructions: ClassVar[tuple[str, ...]] = (
        "insert the orange end of the peg into the hole of the box",
        "pick up the peg and push it into the box from the side",
        "put the peg into the hole",
    )
    max_episode_steps: ClassVar[int] = 250
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, look_at=(0.0, 0.05, 0.1), fovy_deg=38.0)

    peg_half_length_m: float = 0.105
    peg_radius_m: float = 0.02
    clearance_m: float = 0.003
    hole_offset_m: tuple[float, float] = (0.0, 0.0)
    peg_low_m: tuple[float, float] = (-0.1, -0.3)
    peg_high_m: tuple[float, float] = (0.1, 0.0)
    peg_yaw_rad: float = np.pi / 3
    box_low_m: tuple[float, float] = (-0.05, 0.2)
    box_high_m: tuple[float, float] = (0.05, 0.4)
    box_yaw_rad: float = np.pi / 8
    depth_tolerance_m: float = 0.015

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        most = self.peg_half_length_m - self.peg_radius_m - self.clearance_m
        if not max(map(abs, self.hole_offset_m)) < most:
            raise ConfigError(
                f"task_kwargs.hole_offset_m leaves the box: each part is below {most:g} m, given "
                f"{self.hole_offset_m}."
            )

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        item = peg(self.peg_half_length_m, self.peg_radius_m, _ORANGE, _WHITE)
        return (
            item,
            ObjectCfg(name="box", geoms=self._walls, pos=(0.0, 0.3, self.peg_half_length_m), kind="fixed"),
        )

    @property
    def _walls(self) -> tuple[GeomCfg, ...]:
        """Four beams round the hole, which is along x."""
        outer, inner = self.peg_half_length_m, self.peg_radius_m + self.clearance_m
        y, z = self.hole_offset_m
        spans = (
            ((y + inner, outer), (-outer, outer)),
            ((-outer, y - inner), (-outer, outer)),
            ((y - inner, y + inner), (z + inner, outer)),
            ((y - inner, y + inner), (-outer, z - inner)),
        )
        return tuple(
            GeomCfg(
                shape="box",
                size=(outer, (y1 - y0) / 2, (z1 - z0) / 2),
                pos=(0.0, (y0 + y1) / 2, (z0 + z1) / 2),
                rgba=_SAND,
            )
            for (y0, y1), (z0, z1) in spans
        )

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        peg_yaw = np.pi / 2 + rng.uniform(-self.peg_yaw_rad, self.peg_yaw_rad)
        box_yaw = np.pi / 2 + rng.uniform(-self.box_yaw_rad, self.box_yaw_rad)
        return {
            "peg": Start((*rng.uniform(self.peg_low_m, self.peg_high_m), self.peg_radius_m), peg_yaw),
            "box": Start((*rng.uniform(self.box_low_m, self.box_high_m), self.peg_half_length_m), box_yaw),
        }

    @override
    def success(self, state: State) -> Tensor:
        head = self._in_hole(state, self.peg_half_length_m)
        inside = largest(abs(head[:, 1:])) <= self.peg_radius_m + self.clearance_m
        return inside & (head[:, 0] >= -self.depth_tolerance_m)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns ManiSkill's: reach, grasp, line up with the hole, insert."""
        item, robot = state.objects["peg"], self.arm(state)
        grip = on_peg(item, GRIP_M)
        held = is_held(robot, grip, GRASP_REACH_M, 2 * self.peg_radius_m, cfg=self.robot)
        head, middle = self._in_hole(state, self.peg_half_length_m), self._in_hole(state, 0.0)
        off = stack((norm(head[:, 1:]), norm(middle[:, 1:])))
        total, most = off[0] + off[1], largest(off.T)
        lined = 3.0 * (1.0 - tanh(0.5 * total + 4.5 * most))
        inserted = 5.0 * nearness(norm(head)) * (most < LINED_UP_M)
        return (nearness(distance(ee_pos(robot), grip), 4.0) + held * (1.0 + lined + inserted)) / 10.0

    @override
    def observe(self, state: State) -> Tensor:
        """Returns poses of peg and box, end effector, its way to the grip, the head in the hole, (N, 23)."""
        item, box = state.objects["peg"], state.objects["box"]
        hand = ee_pos(self.arm(state))
        head = self._in_hole(state, self.peg_half_length_m)
        return concatenate((item.pos, item.rot, box.pos, box.rot, hand, on_peg(item, GRIP_M) - hand, head))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        item, grip = state.objects["peg"], on_peg(state.objects["peg"], GRIP_M)
        held = is_held(self.arm(state), grip, GRASP_REACH_M, 2 * self.peg_radius_m, cfg=self.robot)
        if bool(held[0]) and item.pos[0, 2] > 2 * self.peg_radius_m:
            return self._insert(state, rng)
        start, turn = grip[0].numpy().copy(), heading(item)
        start[2] = self.peg_radius_m
        noise = first_miss(rng, (0.06, 0.09))
        lift = np.array([*start[:2], self._height + rng.uniform(0.01, 0.03)])
        turn_s = 0.6 + 0.4 * abs(turn - hand_yaw(self.arm(state)))
        return [
            *self.rise(state, 0.12),
            *grasp(way(start + noise, turn, GRASP_OPEN_M, turn_s), start, rng),
            way(lift, turn, GRASP_CLOSED_M, 0.7, hold_s=0.1),
        ]

    def _insert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way of a held peg to before the hole, or, from there, into it."""
        box, depth = state.objects["box"], self.peg_half_length_m - AHEAD_M
        line, (y, z) = heading(box), self.hole_offset_m
        hole = point(box) + y * np.array([-np.sin(line), np.cos(line), 0.0]) + np.array([0.0, 0.0, z])
        ahead, held = np.array([np.cos(line), np.sin(line), 0.0]), Held.of(self, state, "peg")
        where = Insertion(
            goal=Pose.level(hole - depth * ahead, line).rolled(held.pose, 4),  # it is square
            into=ahead,
            back_m=2 * self.peg_half_length_m + READY_M - depth,
            exact_m=EXACT_M,
            exact_rad=EXACT_RAD,
        )
        return insertion_way(held, where, rng)

    @property
    def _height(self) -> float:
        """Height of the hole above the table, m."""
        return self.peg_half_length_m + self.hole_offset_m[1]

    def _in_hole(self, state: State, along_m: float) -> Array:
        """Returns a point of the peg's axis in the hole's frame, whose x is along the hole, (N, 3), m."""
        box: EntityState = state.objects["box"]
        local = rotate(conjugate(box.rot), on_peg(state.objects["peg"], along_m) - box.pos)
        return local - constant((0.0, *self.hole_offset_m), local)

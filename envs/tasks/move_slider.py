"""MoveSliderLeft, after CALVIN (``mees/calvin_env``, ``conf/tasks/new_playtable_tasks.yaml``, MIT).

CALVIN requires that the door has moved by more than 0.15 m to the left since the episode began
(``move_door_rel``). Here an episode begins with the door at its right end, which is the zero of its
joint, so that how far it has moved is the joint's position. Table, blocks and robot stand as in
CALVIN's scene A (``conf/scene/calvin_scene_A.yaml``), 0.44 m lower: the desk is the plane z = 0.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, override

import numpy as np
import torch
from torch import Tensor

from envs.core.errors import ConfigError
from envs.kinematics.waypoints import Waypoint
from envs.robots.franka import FRANKA
from envs.rotations import from_yaw, rotate
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, Rgba, RobotCfg, ScenarioCfg, TableCfg
from envs.state import EntityState, State
from envs.tasks.base import Task
from envs.tasks.calvin_meshes import mesh_table
from envs.tasks.calvin_table import (
    DESK_HEIGHT_M,
    DRAWER_TRAVEL_M,
    HANDLE,
    SLIDE_POS,
    SLIDE_TRAVEL_M,
    SLOPE_RAD,
    SWITCH_TRAVEL_M,
    about_x,
    box_table,
    scaled,
)
from envs.tasks.parameters import interval, parameter
from envs.tasks.skills.from_above import grasp, slide
from envs.tasks.tabletop import (
    CONTROL_20_HZ,
    GRASP_OPEN_M,
    TABLETOP_LOOKS,
    distance,
    ee_pos,
    nearness,
    wrist_camera,
)

SUCCESS_TRAVEL_M = {"calvin": 0.15, "roboverse": 0.07}
"""Distance that the door must move: CALVIN's task (more than this), and the paper's code (at least)."""

TABLE = "play_table"
BLOCKS: dict[str, tuple[float, Rgba]] = {
    "block_pink": (0.020, (0.85, 0.35, 0.6, 1.0)),
    "block_blue": (0.040, (0.1, 0.2, 0.8, 1.0)),
    "block_red": (0.028, (0.75, 0.08, 0.08, 1.0)),
}
"""Name to half length, m, and colour: small, big and middle, as in scene A."""

HOME = (-1.21779206, 1.03987646, 2.11978261, -2.34205014, -0.87015947, 1.64119353, 0.55344866, 0.04, 0.04)
BASE_POS_M = (-0.34, -0.46, 0.24)
"""CALVIN's robot from between the table's feet."""

_PLACED_ROBOT = replace(FRANKA.with_home(HOME), pos=(*BASE_POS_M[:2], BASE_POS_M[2] - DESK_HEIGHT_M))

CAMERA_AZIMUTH_RAD = math.radians(-52.5)
"""Azimuth of the cameras, from +x: between CALVIN's static camera, -36°, and the mean of those of
RoboVerse's CALVIN tasks, -67.5°. From behind, the cabinet hides its door."""

_GREY: Rgba = (0.35, 0.35, 0.37, 1.0)


@dataclass(frozen=True, kw_only=True)
class MoveSliderLeft(Task):
    """Grasp the handle of the play table's sliding door and pull the door to the left.

    Attributes:
        variant: ``calvin`` requires more than 0.15 m, ``roboverse`` 0.07 m.
        success_travel_m: Distance that the door must move, m; None is that of the variant.
        block_half_size_m: Half width and half height of the blocks, m.
        block_x_m: Range of the blocks in x, m: CALVIN's surface "table", less what would touch button, door
            or the desk's edge.
        block_y_m: The same in y.
        block_gap_m: Least distance between the circles round two blocks, m.
        grasp_tilt_rad: Turn of the gripper from the vertical towards the cabinet, rad; the door's own normal
            is at 60°.
        qpos_noise_rad: Standard deviation of the arm's joints at the start, rad.
        calvin_dir: The folder ``data`` of CALVIN's environment, whose meshes then make up the table; None
            builds it from boxes of the same dimensions.
    """

    name: ClassVar[str] = "MoveSliderLeft"
    instructions: ClassVar[tuple[str, ...]] = (
        "push the sliding door to the left side",
        "move the door to the left",
        "grasp the door handle and slide the door to the left",
    )
    max_episode_steps: ClassVar[int] = 150

    variant: Literal["calvin", "roboverse"] = "calvin"
    calvin_dir: str | None = None
    success_travel_m: float | None = parameter(None, above=0.0, at_most=SLIDE_TRAVEL_M - 0.04)
    block_half_size_m: float = parameter(0.02, at_least=0.01, at_most=0.025)
    block_x_m: tuple[float, float] = interval((-0.19, 0.33), at_least=-0.19, at_most=0.33)
    block_y_m: tuple[float, float] = interval((-0.135, -0.052), at_least=-0.135, at_most=-0.052)
    block_gap_m: float = parameter(0.005, at_least=0.0, at_most=0.03)
    grasp_tilt_rad: float = parameter(math.radians(50.0), at_least=0.0, at_most=math.pi / 2)
    qpos_noise_rad: float = parameter(0.02, at_least=0.0, at_most=0.2)

    def __post_init__(self) -> None:
        super().__post_init__()
        needed = sum(2 * radius + self.block_gap_m for radius in self._radii_m[1:]) + self._radii_m[0]
        width = self.block_x_m[1] - self.block_x_m[0]
        if width < needed:
            raise ConfigError(
                f"block_x_m of MoveSliderLeft is {self.block_x_m!r}, too narrow for three blocks side by "
                f"side: its ends must be at least {needed:.3f} m apart."
            )

    @property
    @override
    def robot(self) -> RobotCfg:
        return _PLACED_ROBOT

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        plinth = GeomCfg(
            shape="box",
            size=(0.12, 0.12, BASE_POS_M[2] / 2),
            pos=(*self.robot.pos[:2], BASE_POS_M[2] / 2),
            rgba=_GREY,
        )
        geoms, links = box_table() if self.calvin_dir is None else mesh_table(self.calvin_dir)
        table = ObjectCfg(
            name=TABLE,
            geoms=(*geoms, plinth),
            links=links,
            pos=(0.0, 0.0, -DESK_HEIGHT_M),
            kind="fixed",
        )
        return ScenarioCfg(
            robots=(self.robot,),
            objects=(table, *(self._block(name) for name in BLOCKS)),
            cameras=(_front_camera(), wrist_camera(self.robot)),
            appearance=TABLETOP_LOOKS,
            table=TableCfg(pos=(0.0, -0.1, -DESK_HEIGHT_M), half_size=(0.8, 0.8)),
            physics=CONTROL_20_HZ,
        )

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        count, own, arm = len(rngs), self.robot, list(self.robot.arm)
        qpos = np.tile(np.array(own.default_qpos), (count, 1))
        joints = np.zeros((count, 4))
        blocks, yaws = np.empty((count, len(BLOCKS), 3)), np.empty((count, len(BLOCKS)))
        for row, rng in enumerate(rngs):
            blocks[row] = self._place_blocks(rng)
            yaws[row] = rng.uniform(-np.pi, np.pi, len(BLOCKS))
            joints[row, 1] = rng.uniform(0.0, DRAWER_TRAVEL_M)
            joints[row, 3] = rng.uniform(0.0, SWITCH_TRAVEL_M)
            qpos[row, arm] += rng.normal(0.0, self.qpos_noise_rad, len(arm))
        table = np.tile((0.0, 0.0, -DESK_HEIGHT_M), (count, 1))
        objects = {TABLE: EntityState.at_rest(table, from_yaw(np.zeros(count)), joints)}
        for index, name in enumerate(BLOCKS):
            objects[name] = EntityState.at_rest(blocks[:, index], from_yaw(yaws[:, index]))
        robot = EntityState.at_rest(np.array(own.pos), np.tile(own.rot, (count, 1)), qpos)
        return State({own.name: robot}, objects)

    @override
    def success(self, state: State) -> Tensor:
        table = state.objects[TABLE]
        moved, limit = table.joint_pos[:, 0], self._travel_m
        solved = moved >= limit if self.variant == "roboverse" else moved > limit
        return solved & table.pos.isfinite().all(-1)

    def reward(self, state: State) -> Tensor:
        """Returns 0.75 for the share of the way that the door has moved, and 0.2 for a hand at its handle."""
        table = state.objects[TABLE]
        moved = (table.joint_pos[:, 0] / self._travel_m).clamp(0.0, 1.0)
        reached = nearness(distance(ee_pos(state.robots[self.robot.name]), _handle(table)))
        return 0.75 * moved + 0.2 * reached

    def observe(self, state: State) -> Tensor:
        """Returns hand, way to the handle, the table's joints, door's speed, positions of blocks, (N, 20)."""
        table, hand = state.objects[TABLE], ee_pos(state.robots[self.robot.name])
        blocks = [state.objects[name].pos for name in BLOCKS]
        return torch.cat([hand, _handle(table) - hand, table.joint_pos, table.joint_vel[:, :1], *blocks], -1)

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        table = state.objects[TABLE]
        handle, left = _handle(table)[0].numpy(), np.array([-1.0, 0.0, 0.0])
        along = rng.uniform(-0.03, 0.03)
        point = handle + along * np.array([0.0, math.cos(SLOPE_RAD), math.sin(SLOPE_RAD)])
        tilt = self.grasp_tilt_rad + rng.uniform(-0.1, 0.1)
        towards = np.array([0.0, math.sin(tilt), -math.cos(tilt)])
        pace = rng.uniform(0.9, 1.2)
        travel = self.success_travel_m or SUCCESS_TRAVEL_M["calvin"]
        way = travel + rng.uniform(0.04, 0.08) - float(table.joint_pos[0, 0])

        before = point - rng.uniform(0.07, 0.1) * towards
        come = Waypoint(pos=before, yaw=0.0, roll=tilt, gripper=GRASP_OPEN_M, duration_s=pace * 0.9)
        taken = grasp(come, point, None, down_s=pace * 0.5, settle_s=0.0, close_s=pace * 0.2, hold_s=0.1)
        return [*taken, *slide(taken[-1], (point + way * left,), (pace * 1.3,), hold_s=0.3)]

    @property
    def _travel_m(self) -> float:
        """Distance that the door must move, m."""
        return SUCCESS_TRAVEL_M[self.variant] if self.success_travel_m is None else self.success_travel_m

    @property
    def _radii_m(self) -> list[float]:
        """Radii of the circles round the blocks, seen from above, m."""
        return [math.hypot(half_length, self.block_half_size_m) for half_length, _ in BLOCKS.values()]

    def _block(self, name: str) -> ObjectCfg:
        half_length, rgba = BLOCKS[name]
        half = self.block_half_size_m
        geom = GeomCfg(shape="box", size=(half_length, half, half), mass_kg=0.1, rgba=rgba)
        return ObjectCfg(name=name, geoms=(geom,), pos=(10 * half_length - 0.3, -0.09, half))

    def _place_blocks(self, rng: np.random.Generator) -> np.ndarray:
        """Draws positions (3, 3) of the blocks on the desk, whose circumscribed circles do not touch."""
        radii = self._radii_m
        low, high = zip(self.block_x_m, self.block_y_m, strict=True)
        while True:
            spots = rng.uniform(low, high, (len(radii), 2))
            if all(
                math.dist(spots[i], spots[j]) > radii[i] + radii[j] + self.block_gap_m
                for i in range(len(radii))
                for j in range(i)
            ):
                return np.column_stack([spots, np.full(len(radii), self.block_half_size_m)])


def _front_camera() -> CameraCfg:
    """Returns the pose az+000-pol60 of the camera channel, of which the cabinet hides little."""
    cosine, sine = math.cos(CAMERA_AZIMUTH_RAD), math.sin(CAMERA_AZIMUTH_RAD)
    return CameraCfg(
        name="front",
        pos=(1.299 * cosine, 1.299 * sine, 0.75),
        look_at=(-0.03, -0.05, 0.05),
        fovy_deg=42.0,
        orbit_yaw_rad=CAMERA_AZIMUTH_RAD,
    )


def _handle(table: EntityState) -> Tensor:
    """Returns the middle of the bar of the door's handle in the world, (N, 3)."""
    offset = np.array(scaled(SLIDE_POS)) + rotate(np.array(about_x(SLOPE_RAD)), np.array(scaled(HANDLE)))
    point = table.pos.new_tensor(offset).expand(table.pos.shape[0], 3)
    left = table.pos.new_tensor([-1.0, 0.0, 0.0])
    return table.pos + rotate(table.rot, point + table.joint_pos[:, :1] * left)

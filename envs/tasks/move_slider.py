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

from envs.core.errors import unknown_name
from envs.kinematics.waypoints import Waypoint
from envs.robots.franka import FRANKA
from envs.rotations import from_yaw, rotate
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, Rgba, ScenarioCfg, TableCfg
from envs.state import EntityState, State
from envs.tasks.base import Task
from envs.tasks.calvin_meshes import mesh_table
from envs.tasks.calvin_table import (
    DESK_HEIGHT_M,
    DRAWER_TRAVEL_M,
    HANDLE,
    SLIDE_POS,
    SLOPE_RAD,
    SWITCH_TRAVEL_M,
    about_x,
    box_table,
    scaled,
)
from envs.tasks.tabletop import (
    CONTROL_20_HZ,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    TABLETOP_LOOKS,
    WRIST_CAMERA,
    distance,
    ee_pos,
    nearness,
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

BLOCK_HALF_SIZE_M = 0.02
BLOCK_LOW_M, BLOCK_HIGH_M = (-0.19, -0.135), (0.33, -0.052)
"""Range of the blocks: CALVIN's surface "table", less what would touch button, door or the desk's edge."""

BLOCK_GAP_M = 0.005
"""Least distance between the circles round two blocks."""

QPOS_NOISE_RAD = 0.02
HOME = (-1.21779206, 1.03987646, 2.11978261, -2.34205014, -0.87015947, 1.64119353, 0.55344866, 0.04, 0.04)
BASE_POS_M = (-0.34, -0.46, 0.24)
"""CALVIN's robot from between the table's feet."""

_ROBOT = replace(FRANKA.with_home(HOME), pos=(*BASE_POS_M[:2], BASE_POS_M[2] - DESK_HEIGHT_M))

CAMERA_AZIMUTH_RAD = math.radians(-52.5)
"""Azimuth of the cameras, from +x: between CALVIN's static camera, -36°, and the mean of those of
RoboVerse's CALVIN tasks, -67.5°. From behind, the cabinet hides its door."""

GRASP_TILT_RAD = math.radians(50.0)
"""Turn of the gripper from the vertical towards the cabinet; the door's own normal is at 60°."""

_GREY: Rgba = (0.35, 0.35, 0.37, 1.0)


@dataclass(frozen=True, kw_only=True)
class MoveSliderLeft(Task):
    """Grasp the handle of the play table's sliding door and pull the door to the left.

    Attributes:
        variant: ``calvin`` requires more than 0.15 m, ``roboverse`` 0.07 m.
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

    def __post_init__(self) -> None:
        if self.variant not in SUCCESS_TRAVEL_M:
            raise unknown_name("variant of MoveSliderLeft", str(self.variant), SUCCESS_TRAVEL_M)

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        plinth = GeomCfg(
            shape="box",
            size=(0.12, 0.12, BASE_POS_M[2] / 2),
            pos=(*BASE_POS_M[:2], BASE_POS_M[2] / 2),
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
            robots=(_ROBOT,),
            objects=(table, *(_block(name) for name in BLOCKS)),
            cameras=(_front_camera(), WRIST_CAMERA),
            appearance=TABLETOP_LOOKS,
            table=TableCfg(pos=(0.0, -0.1, -DESK_HEIGHT_M), half_size=(0.8, 0.8)),
            physics=CONTROL_20_HZ,
        )

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        count = len(rngs)
        qpos = np.tile(np.array(_ROBOT.default_qpos), (count, 1))
        joints = np.zeros((count, 4))
        blocks, yaws = np.empty((count, len(BLOCKS), 3)), np.empty((count, len(BLOCKS)))
        for row, rng in enumerate(rngs):
            blocks[row] = _place_blocks(rng)
            yaws[row] = rng.uniform(-np.pi, np.pi, len(BLOCKS))
            joints[row, 1] = rng.uniform(0.0, DRAWER_TRAVEL_M)
            joints[row, 3] = rng.uniform(0.0, SWITCH_TRAVEL_M)
            qpos[row, :7] += rng.normal(0.0, QPOS_NOISE_RAD, 7)
        table = np.tile((0.0, 0.0, -DESK_HEIGHT_M), (count, 1))
        objects = {TABLE: EntityState.at_rest(table, from_yaw(np.zeros(count)), joints)}
        for index, name in enumerate(BLOCKS):
            objects[name] = EntityState.at_rest(blocks[:, index], from_yaw(yaws[:, index]))
        robot = EntityState.at_rest(np.array(_ROBOT.pos), np.tile(_ROBOT.rot, (count, 1)), qpos)
        return State({_ROBOT.name: robot}, objects)

    @override
    def success(self, state: State) -> Tensor:
        table = state.objects[TABLE]
        moved, limit = table.joint_pos[:, 0], SUCCESS_TRAVEL_M[self.variant]
        solved = moved >= limit if self.variant == "roboverse" else moved > limit
        return solved & table.pos.isfinite().all(-1)

    def reward(self, state: State) -> Tensor:
        """Returns 0.75 for the share of the way that the door has moved, and 0.2 for a hand at its handle."""
        table = state.objects[TABLE]
        moved = (table.joint_pos[:, 0] / SUCCESS_TRAVEL_M[self.variant]).clamp(0.0, 1.0)
        reached = nearness(distance(ee_pos(state.robots[_ROBOT.name]), _handle(table)))
        return 0.75 * moved + 0.2 * reached

    def observe(self, state: State) -> Tensor:
        """Returns hand, way to the handle, the table's joints, door's speed, positions of blocks, (N, 20)."""
        table, hand = state.objects[TABLE], ee_pos(state.robots[_ROBOT.name])
        blocks = [state.objects[name].pos for name in BLOCKS]
        return torch.cat([hand, _handle(table) - hand, table.joint_pos, table.joint_vel[:, :1], *blocks], -1)

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        table = state.objects[TABLE]
        handle, left = _handle(table)[0].numpy(), np.array([-1.0, 0.0, 0.0])
        along = rng.uniform(-0.03, 0.03)
        point = handle + along * np.array([0.0, math.cos(SLOPE_RAD), math.sin(SLOPE_RAD)])
        tilt = GRASP_TILT_RAD + rng.uniform(-0.1, 0.1)
        towards = np.array([0.0, math.sin(tilt), -math.cos(tilt)])
        pace = rng.uniform(0.9, 1.2)
        way = SUCCESS_TRAVEL_M["calvin"] + rng.uniform(0.04, 0.08) - float(table.joint_pos[0, 0])

        def at(pos: np.ndarray, gripper: float, duration_s: float, hold_s: float = 0.0) -> Waypoint:
            return Waypoint(
                pos=pos, yaw=0.0, roll=tilt, gripper=gripper, duration_s=pace * duration_s, hold_s=hold_s
            )

        return [
            at(point - rng.uniform(0.07, 0.1) * towards, GRASP_OPEN_M, 0.9),
            at(point, GRASP_OPEN_M, 0.5),
            at(point, GRASP_CLOSED_M, 0.2, hold_s=0.1),
            at(point + way * left, GRASP_CLOSED_M, 1.3, hold_s=0.3),
        ]


def _block(name: str) -> ObjectCfg:
    half_length, rgba = BLOCKS[name]
    half = BLOCK_HALF_SIZE_M
    geom = GeomCfg(shape="box", size=(half_length, half, half), mass_kg=0.1, rgba=rgba)
    return ObjectCfg(name=name, geoms=(geom,), pos=(10 * half_length - 0.3, -0.09, half))


def _place_blocks(rng: np.random.Generator) -> np.ndarray:
    """Draws positions (3, 3) of the blocks on the desk, whose circumscribed circles do not touch."""
    radii = [math.hypot(half_length, BLOCK_HALF_SIZE_M) for half_length, _ in BLOCKS.values()]
    while True:
        spots = rng.uniform(BLOCK_LOW_M, BLOCK_HIGH_M, (len(radii), 2))
        if all(
            math.dist(spots[i], spots[j]) > radii[i] + radii[j] + BLOCK_GAP_M
            for i in range(len(radii))
            for j in range(i)
        ):
            return np.column_stack([spots, np.full(len(radii), BLOCK_HALF_SIZE_M)])


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

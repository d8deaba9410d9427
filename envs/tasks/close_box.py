"""CloseBox, after RLBench (``rlbench/tasks/close_box.py``), with the box of RoboVerse's release.

RLBench requires that the lid's joint has moved by more than 2.6 rad (``JointCondition(box_joint, 2.6)``).
The box is built from the dimensions, masses and joint limits that RoboVerse's URDF of it states
(``box_base_unique.urdf``); frames, sign and zero of its joint are that file's, so that its poses and
joint positions can be used as they are. The box itself does not move: in RoboVerse's 100 recorded
demonstrations its pose is the same in every frame. They give the ranges of its pose, too, and the
robot's posture; RLBench turns the box by at most π/8.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, override

import numpy as np
import torch
from torch import Tensor

from envs.kinematics.waypoints import Waypoint
from envs.robots.franka import FRANKA
from envs.rotations import from_euler, from_yaw, rotate
from envs.scenario import GeomCfg, LinkCfg, ObjectCfg, ObjectJointCfg, Quat, RobotCfg, ScenarioCfg, TableCfg
from envs.state import EntityState, State
from envs.tasks.base import Task
from envs.tasks.parameters import interval, parameter
from envs.tasks.skills.joints import along_joint
from envs.tasks.tabletop import (
    CONTROL_20_HZ,
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    TABLETOP_LOOKS,
    distance,
    ee_pos,
    nearness,
    wrist_camera,
)

CLOSED_RAD, OPEN_RAD = -0.25307273864746, 2.3649210929871
"""Limits of the joint; the lid is level at the first and tilts down, beyond the vertical, at the second."""

BOX_HEIGHT_M = 0.0753
"""Height of the root, at the centre of the box, with the box's floor on the table."""

HINGE_M = (0.076229, -0.123002)
"""The hinge in the box's frame: x, which points up, and y. It is parallel to z."""

LID_TILT_RAD = math.radians(15.0)
"""Angle of the lid against the level when the joint is at zero."""

LID_HALF_SIZE_M = (0.134, 0.005, 0.175)
TRAVEL_RAD = OPEN_RAD - CLOSED_RAD
HOME = (0.0, math.radians(10.0), 0.0, math.radians(-50.0), 0.0, math.radians(70.0), math.pi / 4, 0.04, 0.04)
HOME_TIP_RAD = math.radians(10.0)
"""Forward tilt of the gripper in that posture."""

_PLACED_ROBOT = replace(FRANKA.with_home(HOME), pos=(-0.541, -0.065, 0.0))
"""Robot placement that puts the box, its open lid included, round the world's origin."""

_LID_FRAME = (0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0)
"""The lid's frame in the box's: x along the box's y, y up, z backwards along the hinge."""

PUSH_REACH_M = 0.25
"""Distance of the pushing fingertips from the hinge: their ends reach 2.8 cm under the lid's edge."""

TOUCHING_M = 0.0202
"""Distance of the fingers' middle from the hinge's plane when they touch the lid: 9.3 mm of lid and half
of a finger's width, 10.9 mm."""

TILT_SHARE = 0.85
"""Tilt of the pushing gripper against the vertical, as a share of the lid's: it keeps the wrist higher."""

EASY_REACH_M = 0.53
"""Distance in front of its base where the arm pushes with ease."""

FALLING_RAD = 1.0
"""Angle of the lid against the level to which it is pushed; it falls from the vertical, π/2, on."""

_BLUE = (0.35, 0.47, 0.75, 1.0)


def _box() -> ObjectCfg:
    walls = (
        ((0.0005, 0.125, 0.175), (-0.074754, 0.0, 0.0)),
        ((0.075, 0.005, 0.175), (0.00025, -0.125, 0.0)),
        ((0.075, 0.005, 0.175), (0.00025, 0.125, 0.0)),
        ((0.075, 0.125, 0.005), (0.00024, 0.0, -0.175)),
        ((0.075, 0.125, 0.005), (0.00024, 0.0, 0.175)),
    )
    panel = GeomCfg(
        shape="box",
        size=LID_HALF_SIZE_M,
        pos=(0.126009, 0.038258, 0.0),
        rot=_quat(from_yaw(LID_TILT_RAD)),
        rgba=(0.85, 0.55, 0.25, 1.0),
        mass_kg=0.938,
    )
    joint = ObjectJointCfg(
        kind="hinge",
        axis=(0.0, 0.0, 1.0),
        range=(CLOSED_RAD, OPEN_RAD),
        default=OPEN_RAD,
        damping=0.01,  # and friction: RoboVerse's MJCF of the box
        frictionloss=0.01,
    )
    return ObjectCfg(
        name="box_base",
        geoms=tuple(GeomCfg(shape="box", size=size, pos=pos, rgba=_BLUE) for size, pos in walls),
        links=(LinkCfg(name="box_joint", geoms=(panel,), joint=joint, pos=(*HINGE_M, 0.0), rot=_LID_FRAME),),
        pos=(0.0, 0.0, BOX_HEIGHT_M),
        rot=_quat(_upright(np.zeros(()))),
        kind="fixed",
    )


def _quat(rotation: np.ndarray) -> Quat:
    w, x, y, z = rotation.tolist()
    return (w, x, y, z)


def _upright(yaw: np.ndarray) -> np.ndarray:
    """Returns the orientation (..., 4) of a box that stands on its floor: its x axis points up."""
    zero = np.zeros_like(yaw)
    return from_euler(np.stack([yaw, zero - math.pi / 2, zero], axis=-1))


@dataclass(frozen=True, kw_only=True)
class CloseBox(Task):
    """Close the box by its lid, which lies open beyond the vertical.

    Attributes:
        variant: ``rlbench`` requires ``success_travel_rad``, ``roboverse`` a joint below
            ``roboverse_closed_rad``.
        success_travel_rad: Travel of the lid that solves ``rlbench``, rad; 2.6 ends at -13.5°.
        roboverse_closed_rad: Position of the lid's joint that solves ``roboverse``, rad: -14°.
        spawn_x_m: Range of the box in x from the base of the task's own robot, m.
        spawn_y_m: The same in y.
        spawn_yaw_rad: Range of the box's turn, rad: RLBench's, cut off where that of the demonstrations ends.
        qpos_noise_rad: Standard deviation of the arm's joints at the start, rad.
    """

    name: ClassVar[str] = "CloseBox"
    instructions: ClassVar[tuple[str, ...]] = (
        "close the box",
        "close the lid of the box",
        "shut the box by pushing its lid over",
    )
    max_episode_steps: ClassVar[int] = 200

    variant: Literal["rlbench", "roboverse"] = "rlbench"
    success_travel_rad: float = parameter(2.6, above=0.0, at_most=TRAVEL_RAD)
    roboverse_closed_rad: float = parameter(math.radians(-14.0), at_least=CLOSED_RAD, at_most=OPEN_RAD)
    spawn_x_m: tuple[float, float] = interval((0.437, 0.645), at_least=0.3, at_most=0.8)
    spawn_y_m: tuple[float, float] = interval((0.044, 0.302), at_least=-0.4, at_most=0.4)
    spawn_yaw_rad: tuple[float, float] = interval(
        (-math.pi / 8, 0.221), at_least=-math.pi / 2, at_most=math.pi / 2
    )
    qpos_noise_rad: float = parameter(0.02, at_least=0.0, at_most=0.2)

    @property
    @override
    def robot(self) -> RobotCfg:
        return _PLACED_ROBOT

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        return ScenarioCfg(
            robots=(self.robot,),
            objects=(_box(),),
            cameras=(
                replace(FRONT_CAMERA, look_at=(0.0, -0.05, 0.3), fovy_deg=42.0),
                wrist_camera(self.robot),
            ),
            appearance=TABLETOP_LOOKS,
            table=TableCfg(pos=(-0.12, 0.0, 0.0), half_size=(0.8, 0.8)),
            physics=CONTROL_20_HZ,
        )

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        count, own, arm = len(rngs), self.robot, list(self.robot.arm)
        qpos = np.tile(np.array(own.default_qpos), (count, 1))
        pos, yaw = np.full((count, 3), BOX_HEIGHT_M), np.empty(count)
        low, high = zip(self.spawn_x_m, self.spawn_y_m, strict=True)
        for row, rng in enumerate(rngs):
            pos[row, :2] = rng.uniform(low, high) + np.array(_PLACED_ROBOT.pos[:2])
            yaw[row] = rng.uniform(*self.spawn_yaw_rad)
            qpos[row, arm] += rng.normal(0.0, self.qpos_noise_rad, len(arm))
        box = EntityState.at_rest(pos, _upright(yaw), np.full((count, 1), OPEN_RAD))
        robot = EntityState.at_rest(np.array(own.pos), np.tile(own.rot, (count, 1)), qpos)
        return State({own.name: robot}, {"box_base": box})

    @override
    def success(self, state: State) -> Tensor:
        box = state.objects["box_base"]
        lid = box.joint_pos[:, 0]
        if self.variant == "roboverse":
            solved = lid <= self.roboverse_closed_rad
        else:
            solved = OPEN_RAD - lid > self.success_travel_rad
        return solved & box.pos.isfinite().all(-1)

    def reward(self, state: State) -> Tensor:
        """Returns 0.75 for the share of the way that the lid has moved, and 0.2 for a hand behind it."""
        robot, box = state.robots[self.robot.name], state.objects["box_base"]
        closed = ((OPEN_RAD - box.joint_pos[:, 0]) / TRAVEL_RAD).clamp(0.0, 1.0)
        reached = nearness(distance(ee_pos(robot), _behind_lid(box)))
        return 0.75 * closed + 0.2 * torch.maximum(reached, closed)

    def observe(self, state: State) -> Tensor:
        """Returns box pose, lid angle and speed, end effector, and its way to behind the lid, (N, 15)."""
        box, hand = state.objects["box_base"], ee_pos(state.robots[self.robot.name])
        return torch.cat([box.pos, box.rot, box.joint_pos, box.joint_vel, hand, _behind_lid(box) - hand], -1)

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        box = state.objects["box_base"]
        pos, rot = box.pos[0].numpy(), box.rot[0].numpy()
        start = float(box.joint_pos[0, 0]) + LID_TILT_RAD
        yaw = _heading(rot) + math.pi / 2
        # Where along the edge the arm need neither stretch nor fold.
        away = float(pos[0]) - self.robot.pos[0] - EASY_REACH_M
        along = float(np.clip(away, -0.08, 0.12)) + rng.uniform(-0.02, 0.02)
        grip = PUSH_REACH_M + rng.uniform(-0.005, 0.005)
        pace = rng.uniform(0.95, 1.2)

        def at(angle: float, away: float, reach: float, duration_s: float) -> Waypoint:
            """Fingers that point at the hinge, along the lid at ``angle``; ``away`` from touching it."""
            offset = np.array([*_beside_lid(angle, reach, TOUCHING_M + away), along])
            return Waypoint(
                pos=pos + rotate(rot, offset),
                yaw=yaw,
                pitch=TILT_SHARE * (math.pi / 2 - angle) + HOME_TIP_RAD,
                gripper=GRASP_CLOSED_M,
                duration_s=pace * duration_s,
            )

        return [
            at(start - 0.4, 0.12, grip + 0.08, 1.3),
            at(start, 0.04, grip, 0.9),
            at(start, 0.0, grip, 0.4),
            *along_joint(lambda angle: at(angle, 0.0, grip, 0.4), start, FALLING_RAD, 4),
            at(FALLING_RAD + 0.2, 0.05, grip + 0.1, 0.5),
        ]


def _heading(rot: np.ndarray) -> float:
    """Returns the angle about z from the world's y axis to the box's, rad."""
    x, y, _ = rotate(rot, np.array([0.0, 1.0, 0.0]))
    return math.atan2(-x, y)


def _beside_lid(angle: Any, reach: Any, away: Any) -> tuple[Any, Any]:
    """Returns x and y in the box's frame of a point ``reach`` from the hinge and ``away`` from its plane.

    Args:
        angle: The lid's angle against the level, rad.
        reach: Distance from the hinge along the lid, m.
        away: Distance from the hinge outwards, across the lid, m.
    """
    sine, cosine = (np.sin(angle), np.cos(angle)) if isinstance(angle, float) else (angle.sin(), angle.cos())
    return HINGE_M[0] + reach * sine + away * cosine, HINGE_M[1] + reach * cosine - away * sine


def _behind_lid(box: EntityState) -> Tensor:
    """Returns the point (N, 3) behind the middle of the lid's free edge at which a hand pushes."""
    up, along = _beside_lid(box.joint_pos[:, 0] + LID_TILT_RAD, PUSH_REACH_M, TOUCHING_M)
    return box.pos + rotate(box.rot, torch.stack([up, along, torch.zeros_like(up)], dim=-1))

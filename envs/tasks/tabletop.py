"""Shared parts of tasks of one arm at a table: appearance, cameras, robot, and reward terms."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from torch import Tensor

from envs.array_ops import Array, constant, largest, norm, tanh
from envs.core.errors import ConfigError
from envs.robots import ROBOTS
from envs.robots.franka import FRANKA
from envs.rotations import rotate, wrapped, yaw_of
from envs.scenario import Appearance, CameraCfg, LightCfg, PhysicsCfg, RobotCfg, SurfaceMaterial, Vec3
from envs.state import EntityState
from envs.tasks.robot_columns import columns_of

GRASP_OPEN_M, GRASP_CLOSED_M = 0.04, 0.0
"""Distance of each fingertip from the middle, as in a waypoint; a robot maps it to its gripper's joints."""

PRESS_M = 1e-3
"""How far fingers that hold something are kept from their targets, both together."""

DENSITY_KG_M3 = 1000.0
"""Default of ManiSkill's and of robosuite's shapes."""

STATIC_SPEED_RAD_S = 0.2
"""ManiSkill 3's limit of every arm joint of a robot that is still (``agents/robots/panda/panda.py``)."""

TABLETOP_LOOKS = Appearance(
    materials={
        "table": SurfaceMaterial(rgb=(0.55, 0.45, 0.36), roughness=0.8, specular=0.1),
        "wall": SurfaceMaterial(rgb=(0.75, 0.75, 0.72), roughness=0.9, specular=0.0),
        "ground": SurfaceMaterial(rgb=(0.45, 0.46, 0.48), roughness=0.9, specular=0.05),
    },
    lights=(LightCfg(kind="distant", direction=(-0.25, 0.15, -1.0), intensity=0.75, cast_shadow=True),),
)

FRONT_CAMERA = CameraCfg(name="front", pos=(1.299, 0.0, 0.75), look_at=(0.0, 0.0, 0.13), fovy_deg=23.0)
"""The pose az+000-pol60 of the camera channel, at which the whole workspace fills the image."""

WRIST_CAMERA = CameraCfg(
    name="wrist",
    mount="franka/right_hand",
    pos=(0.11, 0.0, 0.02),
    look_at=(0.03, 0.0, 0.16),
    up=(1.0, 0.0, 0.0),
    fovy_deg=75.0,
)
"""On the hand, looking past the fingers; it sees what the front camera loses behind the hand."""

CAMERAS = (FRONT_CAMERA, WRIST_CAMERA)

CONTROL_20_HZ = PhysicsCfg(timestep_s=0.002, decimation=25)

_POSE_JOINTS = 6
"""A hand's pose has three numbers of its place and three of its turn: an arm of fewer joints misses some."""

FRANKA_AT_TABLE = dataclasses.replace(FRANKA, pos=(-0.615, 0.0, 0.0))
"""Position of the Panda's base on ManiSkill 3's table (``utils/scene_builder/table/scene_builder.py``)."""


def wrist_camera(robot: RobotCfg) -> CameraCfg:
    """Returns the wrist camera on a robot's hand.

    Raises:
        ConfigError: The robot names no body that carries it.
    """
    mount = _camera_mount(robot)
    if mount is None:
        raise ConfigError(
            f"The robot '{robot.name}' has no wrist camera: give its RobotCfg a camera_mount, the body that "
            "carries one. Arms that carry one and have the six joints that a hand needs for any pose: "
            f"{', '.join(filter(_serves, ROBOTS.names('arm')))}."
        )
    return dataclasses.replace(WRIST_CAMERA, mount=f"{robot.name}/{mount}")


def _camera_mount(robot: RobotCfg) -> str | None:
    return robot.camera_mount or robot.gripper_mount


def _serves(name: str) -> bool:
    """Whether a registered arm has a wrist camera, and joints enough for the ways of a table-top task."""
    robot = ROBOTS.get(name)
    return _camera_mount(robot) is not None and len(robot.arm) >= _POSE_JOINTS


def wrist_cameras(robots: Sequence[RobotCfg]) -> tuple[CameraCfg, ...]:
    """Returns the wrist camera of each robot: ``wrist`` of one, ``wrist_<robot>`` of several."""
    if len(robots) == 1:
        return (wrist_camera(robots[0]),)
    return tuple(dataclasses.replace(wrist_camera(item), name=f"wrist_{item.name}") for item in robots)


def ee_pos(robot: EntityState) -> Tensor:
    """Returns the end effector's position, (N, 3)."""
    assert robot.ee_pos is not None, "a simulator gives every robot's end effector"
    return robot.ee_pos


def point_on(entity: EntityState, place: Vec3) -> Array:
    """Returns a point of an entity, given in its frame, in the world, m, (N, 3)."""
    return entity.pos + direction_of(entity, place)


def direction_of(entity: EntityState, direction: Vec3) -> Array:
    """Returns a direction of an entity, given in its frame, in the world, (N, 3)."""
    return rotate(entity.rot, constant(direction, entity.pos))


def hand_yaw(robot: EntityState) -> float:
    """Returns the turn about z of a robot's downward hand, as in a waypoint, of a state of one row, rad."""
    assert robot.ee_rot is not None, "a simulator gives every robot's end effector"
    turn = float(yaw_of(robot.ee_rot[0])) - np.pi / 2  # at turn 0 the hand's x axis points along world y
    return float(wrapped(turn))


def hand_pitch(robot: EntityState) -> float:
    """Returns the pitch of a Franka's hand, as in a waypoint, of a state of one row, rad.

    It is that of a robot whose hand points straight down at rest.
    """
    assert robot.ee_rot is not None, "a simulator gives every robot's end effector"
    turn = hand_yaw(robot)
    fingers = rotate(robot.ee_rot[0].cpu().numpy(), np.array([0.0, 0.0, 1.0]))
    ahead = fingers[0] * np.cos(turn) + fingers[1] * np.sin(turn)
    return -float(np.arcsin(np.clip(ahead, -1.0, 1.0)))


def arm_speed(robot: EntityState, cfg: RobotCfg = FRANKA) -> Tensor:
    """Returns the largest speed of an arm joint, (N,), rad/s.

    Args:
        robot: The robot's state.
        cfg: The robot.
    """
    return largest(abs(robot.joint_vel[:, columns_of(cfg).arm]))


def finger_gap(robot: EntityState, cfg: RobotCfg = FRANKA) -> Tensor:
    """Returns the distance between a robot's fingertips, (N,), m; see :func:`arm_speed`."""
    columns = columns_of(cfg)
    return columns.gap(robot.joint_pos, columns.fingers)


def target_gap(robot: EntityState, cfg: RobotCfg = FRANKA) -> Tensor:
    """Returns the distance between the fingertips that a robot's targets demand, (N,), m."""
    assert robot.joint_target is not None, "a simulator gives every robot's targets"
    columns = columns_of(cfg)
    return columns.gap(robot.joint_target, columns.finger_targets)


def grips_something(robot: EntityState, min_gap_m: float, cfg: RobotCfg = FRANKA) -> Tensor:
    """Returns whether closing fingers are kept apart, (N,): targets below a gap of at least ``min_gap_m``."""
    gap = finger_gap(robot, cfg)
    return (target_gap(robot, cfg) < gap - 0.005) & (gap > min_gap_m)


def distance(a: Tensor, b: Tensor) -> Tensor:
    """Returns the Euclidean distance of points (N, 3), (N,)."""
    return norm(a - b)


def flat_distance(a: Tensor, b: Tensor) -> Tensor:
    """Returns the level distance of points (N, 3), (N,)."""
    return norm((a - b)[:, :2])


def is_held(
    robot: EntityState, point: Tensor, reach_m: float, width_m: float, cfg: RobotCfg = FRANKA
) -> Tensor:
    """Returns whether closing fingers are kept apart by something at a point, (N,).

    ManiSkill and robosuite read contacts instead.

    Args:
        robot: The robot's state.
        point: Where the thing would be gripped, (N, 3), m.
        reach_m: Largest distance of the end effector from there.
        width_m: Width of the thing between the fingers.
        cfg: The robot.
    """
    gap, target = finger_gap(robot, cfg), target_gap(robot, cfg)
    return (distance(ee_pos(robot), point) < reach_m) & (target < gap - PRESS_M) & (gap > 0.75 * width_m)


def nearness(distance_m: Tensor, scale: float = 5.0) -> Tensor:
    """Returns ManiSkill's reward of being near, ``1 - tanh(scale * distance)``, in (0, 1]."""
    return 1.0 - tanh(scale * distance_m)

"""Robot and pedestal of robosuite's tasks, and their base class."""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from envs.kinematics.waypoints import Waypoint
from envs.robots.franka import FRANKA
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, Rgba, RobotCfg, TableCfg
from envs.tasks.arm_at_table import ArmAtTable, way
from envs.tasks.tabletop import FRONT_CAMERA, GRASP_OPEN_M

TABLE_HEIGHT_M = 0.8
"""robosuite's ``table_offset``."""

BASE_HEIGHT_M = 0.912
"""Height of the robot's base on its pedestal."""

HOME = (0.0, np.pi / 16, 0.0, -5 * np.pi / 6, 0.0, np.pi - 0.2, np.pi / 4, GRASP_OPEN_M, GRASP_OPEN_M)
"""``models/robots/manipulators/panda_robot.py``; fingers open."""

UPRIGHT_PITCH_RAD = (np.pi - 0.2) - np.pi / 16 - 5 * np.pi / 6
"""Rotation of the hand from that posture, in which it is tilted by 7°, to straight down."""

_GREY: Rgba = (0.2, 0.2, 0.2, 1.0)


def panda(x_m: float, y_m: float = 0.0, table_height_m: float = TABLE_HEIGHT_M) -> RobotCfg:
    """Returns robosuite's Panda on its pedestal, at a place beside a table top of that height."""
    return dataclasses.replace(FRANKA, pos=(x_m, y_m, BASE_HEIGHT_M - table_height_m)).with_home(HOME)


def pedestal(robot: RobotCfg) -> ObjectCfg:
    """Returns the robot's pedestal: the visual shapes of robosuite's ``bases/rethink_mount.xml``."""
    shapes = (
        GeomCfg(shape="cylinder", size=(0.1, 0.3), pos=(-0.02, 0.0, -0.3), rgba=_GREY),
        GeomCfg(shape="box", size=(0.11, 0.2, 0.265), pos=(-0.325, 0.0, -0.37), rgba=_GREY),
        GeomCfg(shape="box", size=(0.385, 0.35, 0.155), pos=(-0.1225, 0.0, -0.748), rgba=_GREY),
    )
    return ObjectCfg(name="pedestal", geoms=shapes, pos=robot.pos, kind="marker")


PANDA_AT_TABLE = panda(-0.56)
"""``base_xpos_offset`` of a table 0.8 m long."""


@dataclass(frozen=True, kw_only=True)
class RobosuiteTask(ArmAtTable):
    """A task of robosuite's table arena."""

    own_robot: ClassVar[RobotCfg] = PANDA_AT_TABLE
    table: ClassVar[TableCfg] = TableCfg(half_size=(0.4, 0.4), height_m=TABLE_HEIGHT_M)
    camera: ClassVar[CameraCfg] = FRONT_CAMERA
    down_pitch_rad: ClassVar[float] = UPRIGHT_PITCH_RAD


def down(
    pos: np.ndarray, yaw: float, gripper: float, duration_s: float, hold_s: float = 0.0, tip: float = 0.0
) -> Waypoint:
    """Returns a waypoint of a hand that points straight down, or ahead by a negative ``tip``, rad."""
    return way(pos, yaw, gripper, duration_s, hold_s, UPRIGHT_PITCH_RAD + tip)

"""Two Pandas of robosuite that face each other, and the base class of their tasks."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from envs.array_ops import Array
from envs.scenario import CameraCfg, ObjectCfg, RobotCfg, TableCfg
from envs.state import State
from envs.tasks.arms import ArmsAtTable, facing
from envs.tasks.robosuite.scene import TABLE_HEIGHT_M, UPRIGHT_PITCH_RAD, panda, pedestal
from envs.tasks.tabletop import FRONT_CAMERA, is_held

GRASP_REACH_M = 0.03


def opposed(robot: RobotCfg, distance_m: float) -> tuple[RobotCfg, RobotCfg]:
    """Returns two of a robot that face each other along y: the ``opposed`` configuration of robosuite."""
    z = robot.pos[2]
    return (
        facing(robot, f"{robot.name}_left", (0.0, -distance_m, z), math.pi / 2),
        facing(robot, f"{robot.name}_right", (0.0, distance_m, z), -math.pi / 2),
    )


AT_TABLE = opposed(panda(0.0), 0.56)
"""``base_xpos_offset`` of a table 0.8 m long."""


@dataclass(frozen=True, kw_only=True)
class TwoArms(ArmsAtTable):
    """A task of two Pandas on pedestals at robosuite's table."""

    own_robots: ClassVar[tuple[RobotCfg, ...]] = AT_TABLE
    table: ClassVar[TableCfg] = TableCfg(half_size=(0.4, 0.4), height_m=TABLE_HEIGHT_M)
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, look_at=(0.0, 0.0, 0.2), fovy_deg=46.0)
    down_pitch_rad: ClassVar[float] = UPRIGHT_PITCH_RAD

    @property
    def pedestals(self) -> tuple[ObjectCfg, ...]:
        """The robots' pedestals."""
        return tuple(
            replace(pedestal(robot), name=f"pedestal_{robot.name}", rot=robot.rot) for robot in self.robots
        )

    def grasps(self, state: State, index: int, place: Array, width_m: float) -> Array:
        """Returns whether a robot's fingers hold something that wide at a place (N, 3), (N,)."""
        robot = self.robots[index]
        return is_held(state.robots[robot.name], place, GRASP_REACH_M, width_m, cfg=robot)

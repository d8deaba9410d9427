"""Base of the tasks of an SO-101: where it stands, what it sees, and how its hand takes hold of something.

The arm has five joints: a hand that points straight down reaches 0.12 to 0.28 m from the base where it is up
to 6 cm above the table, and 0.16 to 0.24 m at 9 cm; higher up the wrist's range ends. Tasks stay inside, so
their waypoints are downward poses with any turn about the vertical.

At turn 0 the hand's x axis, along which the jaw opens, points away from the base. The finger on its other
side does not move, so an open hand is brought beside a thing with that finger near to it.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np

from envs.kinematics.waypoints import Waypoint
from envs.robots.so101 import SO101
from envs.scenario import CameraCfg, PhysicsCfg, RobotCfg, ScenarioCfg, TableCfg
from envs.state import State
from envs.tasks.arm_at_table import ArmAtTable
from envs.tasks.skills.from_above import grasp

REST_RAD = (-0.0013879, -0.4283394, 0.4628485, 1.5362872, 0.0472916, 0.6)
"""Posture whose hand is 8 cm above the table, 0.19 m from the base, and points straight down."""

CONTROL_30_HZ = PhysicsCfg(timestep_s=1.0 / 480.0, decimation=16)
"""The rate at which LeRobot records an SO-101 by default."""

ORBIT_POS_M, ORBIT_RADIUS_M = (0.18, 0.0, 0.0), 0.55
"""Sphere of the camera channel: a camera that stands on the same table."""

FRONT_CAMERA = CameraCfg(
    name="front",
    pos=(0.656, 0.0, 0.275),
    look_at=(0.16, 0.0, 0.07),
    fovy_deg=42.0,
    width=640,
    height=480,
    orbit_pos=ORBIT_POS_M,
    orbit_radius_m=ORBIT_RADIUS_M,
)
"""Opposite the arm, at the pose az+000-pol60 of the camera channel."""

WRIST_CAMERA = CameraCfg(
    name="wrist",
    pos=(0.01, -0.07, -0.005),
    look_at=(0.01, -0.02, -0.11),
    up=(1.0, 0.0, 0.0),
    fovy_deg=75.0,
    width=640,
    height=480,
)
"""On the gripper's body, beside the fingers; the maker's mount of a 32 mm camera board is there."""

SITE_TO_FINGER_M = 0.015
"""Distance from the grip site to the face of the finger that does not move (``so101.xml``)."""

CLEAR_M = 0.006
"""Distance from there to a thing when the open hand comes down beside it."""

LOW_M = 0.019
"""Least height of the grip site: the closed jaw's tip is then 4 mm above the table."""

HIGH_M = 0.075
"""Height of the grip site at which a hand passes over what lies on the table."""

RISE_M = 0.06
"""Height to which a low hand rises before it goes anywhere."""

NEAR_M = 0.048
"""Height of the grip site at which the fingertips, 15 mm below it, are just above a cube of 3 cm."""

OPEN_M, CLOSED_M = 0.0269, 0.0
"""Half of the distance between the fingers, as in a waypoint."""


@dataclass(frozen=True, kw_only=True)
class So101Task(ArmAtTable):
    """An SO-101 at a table, whose base is the world's origin and which faces +x."""

    own_robot: ClassVar[RobotCfg] = SO101.with_home(REST_RAD)
    camera: ClassVar[CameraCfg] = FRONT_CAMERA
    table: ClassVar[TableCfg] = TableCfg(pos=(0.2, 0.0, 0.0), half_size=(0.4, 0.5))

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        own = super().scenario
        wrist = replace(WRIST_CAMERA, mount=own.cameras[1].mount)
        return replace(own, cameras=(self.camera, wrist), physics=CONTROL_30_HZ)

    @override
    def rise(self, state: State, height_m: float) -> list[Waypoint]:
        """See :meth:`ArmAtTable.rise`; from where its targets are, since its small motors give way."""
        now = self.commanded(state)
        if now.pos[2] >= height_m - 0.005:
            return []
        rise_s = 0.3 + 4.0 * float(height_m - now.pos[2])
        return [replace(now, pos=lifted(now.pos, height_m), gripper=OPEN_M, duration_s=rise_s)]


def lifted(pos: np.ndarray, height_m: float = HIGH_M) -> np.ndarray:
    """Returns the point straight above a point, at a height, m, (3,)."""
    return np.array([pos[0], pos[1], height_m])


def beside(middle: np.ndarray, half_width_m: float, yaw: float) -> np.ndarray:
    """Returns where the grip site is when the finger that does not move touches a thing.

    Args:
        middle: Middle of the thing, at the height of the site, m, (3,).
        half_width_m: Half its width along the hand's x axis.
        yaw: Turn of the hand, as in a waypoint.
    """
    return middle + (SITE_TO_FINGER_M - half_width_m) * np.array([np.cos(yaw), np.sin(yaw), 0.0])


def take(come: Waypoint, grip: np.ndarray, yaw: float, off_m: np.ndarray | None = None) -> list[Waypoint]:
    """Returns the way of an open hand to a thing and the grasp, from where the hand first comes.

    Args:
        come: The first waypoint, over the thing; it may be off, and its turn too.
        grip: The grip site in the grasp; see :func:`beside`.
        yaw: Turn of the hand in the grasp.
        off_m: How far the hand is off once more when its fingers are just above the thing, m, (2,).
    """
    clear = -CLEAR_M * np.array([np.cos(yaw), np.sin(yaw), 0.0])
    turn_s = 0.2 + abs(yaw - come.yaw)
    over = replace(come, pos=lifted(grip + clear, float(come.pos[2])), yaw=yaw, duration_s=turn_s)
    ways, last = [come], over
    if off_m is not None:
        near = lifted(grip + clear, NEAR_M)
        ways += [over, replace(over, pos=near + np.array([*off_m, 0.0]), duration_s=0.3)]
        last = replace(over, pos=near, duration_s=0.1 + 10.0 * float(np.linalg.norm(off_m)))
    held = grasp(last, grip, None, clear=clear, settle_s=0.07, close_s=0.2, hold_s=0.2)
    return [*ways, *held]

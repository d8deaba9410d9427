"""Base of tasks of one Panda at a table whose episodes begin with objects at random places."""

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, ClassVar, NamedTuple, override

import numpy as np
import torch

from envs.core.errors import ConfigError
from envs.kinematics.forward import KinematicChain
from envs.kinematics.waypoints import Waypoint
from envs.rotations import conjugate, from_matrix, from_yaw, multiply, to_euler, yaw_of
from envs.scenario import CameraCfg, ObjectCfg, RobotCfg, ScenarioCfg, TableCfg
from envs.state import EntityState, State
from envs.tasks.base import Task
from envs.tasks.tabletop import (
    CONTROL_20_HZ,
    FRANKA_AT_TABLE,
    FRONT_CAMERA,
    GRASP_OPEN_M,
    TABLETOP_LOOKS,
    ee_pos,
    hand_yaw,
    wrist_cameras,
)

EASY_REACH_M = 0.72
"""Distance from the base up to which a Panda's hand points straight down with ease."""


class Start(NamedTuple):
    """Where an object starts.

    Attributes:
        pos: Position, m, (3,).
        yaw_rad: Turn about z.
        joints: Joint positions, rad (m).
        rot: Orientation instead of that turn, wxyz, (4,).
    """

    pos: Sequence[float] | np.ndarray
    yaw_rad: float = 0.0
    joints: tuple[float, ...] = ()
    rot: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class ArmAtTable(Task):
    """A Panda at a table. A task says which objects there are and where they start.

    Attributes:
        qpos_noise_rad: Standard deviation of each arm joint's start.
    """

    takes_arrays: ClassVar[bool] = True
    own_robot: ClassVar[RobotCfg] = FRANKA_AT_TABLE
    camera: ClassVar[CameraCfg] = FRONT_CAMERA
    table: ClassVar[TableCfg] = TableCfg(pos=(-0.12, 0.0, 0.0), half_size=(0.8, 0.8))
    down_pitch_rad: ClassVar[float] = 0.0
    """Pitch, in a waypoint, of a hand that points straight down."""

    qpos_noise_rad: float = 0.02

    def __post_init__(self) -> None:
        for item in fields(self):
            check_option(f"task_kwargs.{item.name}", getattr(self, item.name), item.default)

    @property
    @override
    def robot(self) -> RobotCfg:
        return self.own_robot

    @property
    @abstractmethod
    def objects(self) -> tuple[ObjectCfg, ...]:
        """The objects of the scene; those that :meth:`starts` leaves out stay at their own pose."""

    @abstractmethod
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        """Draws where objects start, by name."""

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        return ScenarioCfg(
            robots=self.robots,
            objects=self.objects,
            cameras=(self.camera, *wrist_cameras(self.robots)),
            appearance=TABLETOP_LOOKS,
            table=self.table,
            physics=CONTROL_20_HZ,
        )

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        count, robots = len(rngs), self.robots
        qpos = [np.tile(np.array(robot.default_qpos), (count, 1)) for robot in robots]
        drawn: list[dict[str, Start]] = []
        for row, rng in enumerate(rngs):
            drawn.append(self.starts(rng))
            for robot, joints in zip(robots, qpos, strict=True):
                arm = list(robot.arm)
                joints[row, arm] += rng.normal(0.0, self.qpos_noise_rad, len(arm))
        arms = {
            robot.name: EntityState.at_rest(np.array(robot.pos), np.tile(robot.rot, (count, 1)), joints)
            for robot, joints in zip(robots, qpos, strict=True)
        }
        return State(arms, {item.name: _at_rest(item, drawn) for item in self.objects})

    def arm(self, state: State) -> EntityState:
        """Returns the robot's state."""
        return state.robots[self.robot.name]

    def commanded(self, state: State) -> Waypoint:
        """Returns the pose of the hand that the robot's targets stand for, of a state of one row.

        A load keeps the hand from it. A correction of where the hand is, added to it, ends where it should.
        """
        return commanded(self.robot, self.arm(state))

    def rise(self, state: State, height_m: float) -> list[Waypoint]:
        """Returns the way straight up with an open hand, of a state of one row; none if it is high enough.

        An expert that plans again after a failed try leaves the place without pushing anything.
        """
        hand = ee_pos(self.arm(state))[0].numpy()
        if hand[2] >= height_m:
            return []
        up = np.array([hand[0], hand[1], height_m + 0.01])
        rise_s = 0.4 + 2.0 * float(up[2] - hand[2])
        return [way(up, hand_yaw(self.arm(state)), GRASP_OPEN_M, rise_s, pitch=self.down_pitch_rad)]


def check_option(key: str, value: Any, default: Any) -> None:
    """Checks a size, a range or a switch of a task against its default.

    Raises:
        ConfigError: if it is of another kind, if a single number is negative, or if a range is reversed.
    """
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise ConfigError(f"{key} is true or false, given {value!r}.")
        return
    count = len(default) if isinstance(default, tuple) else 1
    numbers: list[Any] = (
        list(value) if isinstance(value, Sequence) and not isinstance(value, str) else [value]
    )
    valid = len(numbers) == count and all(
        isinstance(number, int | float) and not isinstance(number, bool) and math.isfinite(number)
        for number in numbers
    )
    if not valid or (count == 1 and numbers[0] < 0):
        what = f"{count} numbers, such as {list(default)}" if count > 1 else "a number of at least 0"
        raise ConfigError(f"{key} is {what}, given {value!r}.")
    if key.endswith(("_x_m", "_y_m", "yaw_rad")) and count == 2 and numbers[0] > numbers[1]:
        raise ConfigError(f"{key} is a range, from the lower to the higher number, given {value!r}.")


@cache
def chain_at_rest(robot: RobotCfg) -> tuple[KinematicChain, np.ndarray]:
    """Returns a robot's forward kinematics, and the orientation (4,) of its hand at rest."""
    chain = KinematicChain(robot)
    rest = torch.tensor([robot.default_qpos], dtype=torch.float64)
    return chain, from_matrix(chain(rest[:, chain.columns]).rot[0].numpy())


def commanded(robot: RobotCfg, arm: EntityState) -> Waypoint:
    """Returns the pose of a hand that a robot's targets stand for; see :meth:`ArmAtTable.commanded`."""
    assert arm.joint_target is not None, "a simulator gives every robot's targets"
    chain, _ = chain_at_rest(robot)
    poses = chain(arm.joint_target[:1, chain.columns].to(torch.float64))
    return posed(robot, poses.pos[0].numpy(), from_matrix(poses.rot[0].numpy()), 0.0, 0.0)


def posed(
    robot: RobotCfg, pos: np.ndarray, rot: np.ndarray, gripper: float, duration_s: float, hold_s: float = 0.0
) -> Waypoint:
    """Returns the waypoint of a hand in any orientation.

    Args:
        robot: The robot.
        pos: Position of its end effector in the world, m, (3,).
        rot: Orientation of its end effector in the world, wxyz, (4,).
        gripper: Distance of each fingertip from the middle, m.
        duration_s: Time to come there.
        hold_s: Time to wait there.
    """
    turn = to_euler(multiply(rot, conjugate(chain_at_rest(robot)[1])))
    yaw, pitch, roll = (float(angle) for angle in turn)
    return Waypoint(
        pos=np.asarray(pos, np.float64),
        yaw=yaw,
        pitch=pitch,
        roll=roll,
        gripper=gripper,
        duration_s=duration_s,
        hold_s=hold_s,
    )


def hand_axes(forward: np.ndarray, opening: np.ndarray) -> np.ndarray:
    """Returns the axes of a hand as columns, (3, 3): its fingers open along x, and z points forward.

    Args:
        forward: Where its fingers point, (3,).
        opening: Line along which they open; what of it is along ``forward`` is left out, (3,).
    """
    z = forward / np.linalg.norm(forward)
    x = opening - np.dot(opening, z) * z
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _at_rest(item: ObjectCfg, drawn: Sequence[dict[str, Start]]) -> EntityState:
    if item.name not in drawn[0]:
        return EntityState.at_rest(np.array(item.pos), np.tile(item.rot, (len(drawn), 1)))
    starts = [row[item.name] for row in drawn]
    pos = np.array([start.pos for start in starts], np.float64)
    rot = from_yaw(np.array([start.yaw_rad for start in starts]))
    for row, start in enumerate(starts):
        rot[row] = rot[row] if start.rot is None else start.rot
    return EntityState.at_rest(pos, rot, np.array([start.joints for start in starts], np.float64))


def way(
    pos: np.ndarray, yaw: float, gripper: float, duration_s: float, hold_s: float = 0.0, pitch: float = 0.0
) -> Waypoint:
    """Returns a waypoint; see :class:`~envs.kinematics.waypoints.Waypoint`."""
    return Waypoint(pos=pos, yaw=yaw, gripper=gripper, duration_s=duration_s, hold_s=hold_s, pitch=pitch)


def point(entity: EntityState) -> np.ndarray:
    """Returns the position of an entity in a state of one row, m, (3,)."""
    return entity.pos[0].numpy().copy()


def heading(entity: EntityState) -> float:
    """Returns the angle of an entity's x axis about z in a state of one row, rad."""
    return float(yaw_of(entity.rot[0].numpy()))


def above(pos: np.ndarray, height_m: float) -> np.ndarray:
    """Returns the point so far above a point, m, (3,)."""
    return pos + np.array([0.0, 0.0, height_m])


def tip_to_reach(pos: np.ndarray, robot: RobotCfg) -> float:
    """Returns the pitch of the hand that brings a far place on the table within a Panda's reach, rad.

    A hand that points straight down reaches 0.8 m from the base; one whose fingers point ahead reaches as far
    as its 0.21 m from flange to fingertips lean.
    """
    far = float(np.linalg.norm(pos[:2] - np.array(robot.pos[:2])))
    return -float(np.clip(4.0 * (far - EASY_REACH_M), 0.0, 0.6))


def travel_s(start: np.ndarray, end: np.ndarray, least_s: float = 0.3) -> float:
    """Returns the time of an expert's motion between two points, (3,), m."""
    return least_s + 1.5 * float(np.linalg.norm(end - start))

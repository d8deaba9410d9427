"""Source demonstrations: the hand's commanded path and the objects around it, from recorded states.

Shapes: T = control steps; T + 1 states, one before each step and one after the last.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from envs.core.errors import ConfigError
from envs.kinematics.forward import KinematicChain
from envs.rotations import from_matrix
from envs.scenario import RobotCfg
from envs.state import State
from envs.tasks.base import Task
from roboverse_learn.data.augmentation.pose import Pose

_CHANGE = 0.02
"""Share of the gripper's range that its target must move by in a step to be a change."""


@dataclass(frozen=True, eq=False)
class SourceDemo:
    """One demonstration.

    Attributes:
        index: Its episode in the dataset.
        states: T + 1 states, on the CPU.
        commanded: Hand poses that the joint targets of each step ask for, (T,). They differ from the measured
            ones where the hand pushes or closes.
        gripper: Mean target of the gripper's joints, (T,), m or rad.
        gripper_range: Its least and largest value.
    """

    index: int
    states: State
    commanded: Pose
    gripper: np.ndarray
    gripper_range: tuple[float, float]

    @property
    def num_steps(self) -> int:
        """T."""
        return len(self.gripper)

    @cached_property
    def hand(self) -> Pose:
        """Measured hand poses, (T + 1,)."""
        return measured_hand(self.states)

    @cached_property
    def gripper_changes(self) -> tuple[int, ...]:
        """Steps at which the gripper's target begins to move; movements one step apart are one."""
        low, high = self.gripper_range
        moving = np.abs(np.diff(self.gripper)) > _CHANGE * (high - low)
        steps = np.flatnonzero(moving) + 1
        return tuple(int(step) for step in steps if step - 1 not in steps and step - 2 not in steps)


class HandReader:
    """Forward kinematics of the hand of a robot with a gripper.

    Args:
        robot: The robot, where its base stands.
    """

    def __init__(self, robot: RobotCfg) -> None:
        self.robot = robot
        self._chain = KinematicChain(self.robot)
        self._fingers = [self.robot.joint_names.index(name) for name in self.robot.gripper_joints]
        ranges = np.array([self.robot.joints[index].range for index in self._fingers])
        self.gripper_range = (float(ranges[:, 0].mean()), float(ranges[:, 1].mean()))

    @classmethod
    def of(cls, task: Task) -> "HandReader":
        """Returns the reader of a task's robot.

        Raises:
            ConfigError: It has no gripper, or the task's actions are not the joint targets of the robot.
        """
        robot = task.only_robot("source=augment")
        driven = tuple(robot.joint_names[index] for index in robot.driven)
        if tuple(task.controller.names) != driven or not robot.gripper_joints:
            raise ConfigError(
                f"source=augment moves the hand of an arm by joint targets, and the actions of {task.name} "
                f"are {', '.join(task.controller.names)}. Use source=expert or source=policy."
            )
        return cls(robot)

    def starts(self, state: State) -> np.ndarray:
        """Returns targets (N, J) of driven joints, which a load keeps them from, and positions of others."""
        robot = state.robots[self.robot.name]
        starts = robot.joint_pos.clone()
        if robot.joint_target is not None:
            starts[:, list(self.robot.driven)] = robot.joint_target
        return starts.cpu().double().numpy()

    def hands(self, joints: np.ndarray) -> Pose:
        """Returns where joint positions, or targets, (N, J) put the hand, (N,)."""
        poses = self._chain(
            torch.from_numpy(np.ascontiguousarray(joints[:, self._chain.columns], np.float64))
        )
        return Pose(poses.pos.numpy(), from_matrix(poses.rot.numpy()))

    def gripper(self, joints: np.ndarray) -> np.ndarray:
        """Returns the mean of the gripper's joints, (N,)."""
        return joints[:, self._fingers].mean(axis=1)

    def with_gripper(self, joints: np.ndarray, gripper: np.ndarray) -> np.ndarray:
        """Returns targets (N, J) whose gripper's joints are at ``gripper`` (N,)."""
        joints = joints.copy()
        joints[:, self._fingers] = gripper[:, None]
        return joints

    def demo(self, index: int, states: State) -> SourceDemo:
        """Returns a demonstration from its states."""
        joints = self.starts(states)[1:]
        return SourceDemo(index, states, self.hands(joints), self.gripper(joints), self.gripper_range)


def measured_hand(state: State) -> Pose:
    """Returns where the first robot's hand is, (N,)."""
    robot = next(iter(state.robots.values()))
    assert robot.ee_pos is not None and robot.ee_rot is not None, "a simulator gives every end effector"
    return Pose(robot.ee_pos.cpu().numpy(), robot.ee_rot.cpu().numpy())

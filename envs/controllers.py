"""What an action means: how a row of numbers becomes something a simulator is told."""

from abc import ABC, abstractmethod
from typing import override

import numpy as np
import torch

from envs.handlers.base import EnvIds, Handler
from envs.scenario import Quat, RobotCfg, Vec3
from envs.state import State


class Controller(ABC):
    """Applies actions.

    Attributes:
        names: What each entry of an action is, A of them.
        low: Least value of each entry, (A,) float32.
        high: Largest value of each entry, (A,) float32.
    """

    names: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray

    @abstractmethod
    def apply(self, handler: Handler, actions: np.ndarray, env_ids: EnvIds = None) -> None:
        """Tells the simulator what the actions (n, A) of the environments ``env_ids`` mean."""

    @abstractmethod
    def hold(self, state: State) -> np.ndarray:
        """Returns actions (N, A) that keep the robot where it is in ``state``."""


class JointPositionController(Controller):
    """An action is the position target of every joint of one robot, rad and m.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: RobotCfg) -> None:
        self.names = robot.joint_names
        self.low, self.high = np.array([joint.range for joint in robot.joints], np.float32).T
        self._robot = robot.name

    @override
    def apply(self, handler: Handler, actions: np.ndarray, env_ids: EnvIds = None) -> None:
        handler.set_joint_targets({self._robot: actions}, env_ids)

    @override
    def hold(self, state: State) -> np.ndarray:
        return state.robots[self._robot].joint_pos.cpu().numpy()


class PulledHandController(Controller):
    """An action moves the object that pulls a robot's hand, and presses the fingers: x, y, z, gripper.

    This is Meta-World's control (``sawyer_xyz_env.py``, ``set_xyz_action``). Every entry lies in [-1, 1];
    what lies beyond is clipped.

    Args:
        robot: A robot whose driven joints are two fingers that close towards each other along one axis.
        target: Name of the object that pulls the hand.
        low: Least position of the target, m, (3,).
        high: Largest position of the target, m, (3,).
        step_m: Way of the target at an action of 1.
        rot: Orientation of the target, wxyz.
    """

    def __init__(
        self, robot: RobotCfg, target: str, *, low: Vec3, high: Vec3, step_m: float, rot: Quat
    ) -> None:
        self.names = ("x", "y", "z", "gripper")
        self.low, self.high = -np.ones(4, np.float32), np.ones(4, np.float32)
        self._robot, self._target, self._step_m = robot.name, target, step_m
        self._bounds = np.array([low, high])
        self._rot = torch.tensor(rot, dtype=torch.float64)

    @override
    def apply(self, handler: Handler, actions: np.ndarray, env_ids: EnvIds = None) -> None:
        actions = np.clip(actions, -1.0, 1.0)
        present = handler.get_states(env_ids).objects[self._target].pos
        moved = present.cpu().numpy() + actions[:, :3] * self._step_m
        pos = torch.from_numpy(np.clip(moved, *self._bounds))
        handler.set_poses({self._target: (pos, self._rot.expand(len(pos), 4))}, env_ids)
        effort = actions[:, 3:]
        handler.set_joint_targets({self._robot: np.concatenate([effort, -effort], axis=1)}, env_ids)

    @override
    def hold(self, state: State) -> np.ndarray:
        target = state.robots[self._robot].joint_target
        assert target is not None, "a simulator gives every robot's targets"
        return np.pad(target[:, :1].cpu().numpy(), ((0, 0), (3, 0)))

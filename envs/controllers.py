"""What an action means: how a row of numbers becomes something a simulator is told."""

from abc import ABC, abstractmethod
from typing import override

import numpy as np

from envs.handlers.base import EnvIds, Handler
from envs.scenario import RobotCfg


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

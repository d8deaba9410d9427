"""Tasks of another benchmark that also take its actions and give its observations."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal, override

from torch import Tensor

from envs.controllers import Controller
from envs.state import EntityState, State
from envs.tasks.base import Task
from envs.tasks.planner import Planner

Space = Literal["joints", "native"]


@dataclass(frozen=True, kw_only=True)
class NativeSpaces(Task):
    """A task of a benchmark that has spaces of its own, beside those of our tasks.

    Attributes:
        action_space: ``joints`` for targets of all joints, ``native`` for the benchmark's actions.
        observation_space: ``joints`` for positions of all joints, ``native`` for the benchmark's observation.
        native_names: Name of each number of the benchmark's observation of the robot.
        native_limits: Their lowest and highest values.
    """

    native_names: ClassVar[tuple[str, ...]]
    native_limits: ClassVar[tuple[tuple[float, ...], tuple[float, ...]]]

    action_space: Space = "joints"
    observation_space: Space = "joints"

    @abstractmethod
    def native_controller(self) -> Controller:
        """Returns the controller of the benchmark's actions."""

    @abstractmethod
    def native_planner(self) -> Planner:
        """Returns the planner that follows the expert's waypoints by the benchmark's actions."""

    @abstractmethod
    def native_state(self, robot: EntityState) -> Tensor:
        """Returns the benchmark's observation of the robot, (N, D)."""

    @property
    @override
    def controller(self) -> Controller:
        return super().controller if self.action_space == "joints" else self.native_controller()

    @property
    @override
    def planner(self) -> Planner:
        return super().planner if self.action_space == "joints" else self.native_planner()

    @property
    @override
    def state_names(self) -> tuple[str, ...]:
        return super().state_names if self.observation_space == "joints" else self.native_names

    @property
    @override
    def state_limits(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        return super().state_limits if self.observation_space == "joints" else self.native_limits

    @override
    def proprioception(self, state: State) -> Tensor:
        if self.observation_space == "joints":
            return super().proprioception(state)
        return self.native_state(state.robots[self.robot.name])

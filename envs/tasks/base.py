"""What a task is: a scenario, where it starts, when it is solved, what it pays, how an expert does it."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from torch import Tensor

from envs.scenario import ScenarioCfg
from envs.state import State

if TYPE_CHECKING:
    from envs.controllers import Controller
    from envs.experts.planner import Planner
    from envs.experts.waypoints import Waypoint


class Task(ABC):
    """Pure functions of batched states. A task knows no simulator.

    Subclasses are frozen dataclasses; their fields are the task's options.

    Attributes:
        name: Registered name.
        instructions: What to do, in words; an episode draws one.
        max_episode_steps: Control steps after which an episode is cut off.
    """

    name: ClassVar[str]
    instructions: ClassVar[tuple[str, ...]]
    max_episode_steps: ClassVar[int]

    @property
    def description(self) -> str:
        """The first of the instructions."""
        return self.instructions[0]

    @property
    @abstractmethod
    def scenario(self) -> ScenarioCfg:
        """The scene."""

    @abstractmethod
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        """Draws one initial state per generator: a :class:`State` of ``len(rngs)`` rows, float64."""

    @abstractmethod
    def success(self, state: State) -> Tensor:
        """Returns whether the task is solved, (N,) bool. A state that is not finite is no success."""

    @abstractmethod
    def reward(self, state: State) -> Tensor:
        """Returns the dense reward of states that are no success, in [0, 1), (N,); success pays 1."""

    @abstractmethod
    def observe(self, state: State) -> Tensor:
        """Returns what a policy without cameras has to know beside the joints, (N, D)."""

    @abstractmethod
    def expert(self, state: State, rng: np.random.Generator) -> "list[Waypoint]":
        """Returns a way to solve the task from a state of one row; ``rng`` gives it variety.

        When the way has been gone without success, the expert is asked again, from where it got to: a
        grasp that failed is tried once more. No waypoints mean that it gives up.
        """

    @property
    def controller(self) -> "Controller":
        """What an action means; by default position targets of all joints of the first robot."""
        from envs.controllers import JointPositionController

        return JointPositionController(self.scenario.robots[0])

    @property
    def planner(self) -> "Planner":
        """What turns states into the expert's actions; by default inverse kinematics along its waypoints."""
        from envs.experts.ik import WaypointPlanner

        return WaypointPlanner(self)

    def instruction(self, rng: np.random.Generator) -> str:
        """Draws one of the instructions."""
        return self.instructions[int(rng.integers(len(self.instructions)))]

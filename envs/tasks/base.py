"""What a task is: a scenario, where it starts, when it is solved, what it pays, how an expert does it."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import torch
from torch import Tensor

from envs.array_ops import concatenate
from envs.core.errors import ConfigError
from envs.scenario import ScenarioCfg
from envs.state import State

if TYPE_CHECKING:
    from envs.controllers import Controller
    from envs.kinematics.waypoints import Waypoint
    from envs.tasks.planner import Planner


class Task(ABC):
    """Pure functions of batched states. A task knows no simulator.

    Subclasses are frozen dataclasses; their fields are the task's options.

    Attributes:
        name: Registered name.
        instructions: What to do, in words; an episode draws one.
        max_episode_steps: Control steps after which an episode is cut off.
        ends_on_success: Whether an episode is over, and pays 1, as soon as it is solved. If not, success
            is that of its last state, and every step pays the reward.
        success_return: The return from which on an episode counts as solved, which is decided when it is
            over; None leaves that to :meth:`success`.
        has_expert: Whether :meth:`expert` knows a way; demonstrations come from elsewhere if not.
        has_reward: Whether :meth:`reward` tells better states from worse ones.
        takes_arrays: Whether :meth:`success`, :meth:`failure`, :meth:`reward` and :meth:`observe` also take
            a state of numpy arrays, and then return arrays (see :mod:`envs.array_ops`), which is quicker for
            few environments.
    """

    name: ClassVar[str]
    instructions: ClassVar[tuple[str, ...]]
    max_episode_steps: ClassVar[int]
    ends_on_success: ClassVar[bool] = True
    success_return: ClassVar[float | None] = None
    has_expert: ClassVar[bool] = True
    has_reward: ClassVar[bool] = True
    takes_arrays: ClassVar[bool] = False

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

    def failure(self, state: State) -> Tensor:
        """Returns whether all is lost, which ends an episode, (N,) bool; never by default."""
        return torch.zeros(state.num_envs, dtype=torch.bool, device=state.device)

    @abstractmethod
    def reward(self, state: State) -> Tensor:
        """Returns the dense reward of a step that led to each state, (N,).

        Where success ends an episode it pays 1, and all other states less, from 0 on.
        """

    @abstractmethod
    def observe(self, state: State) -> Tensor:
        """Returns what a policy without cameras has to know beside the joints, (N, D)."""

    def expert(self, state: State, rng: np.random.Generator) -> "list[Waypoint]":
        """Returns a way to solve the task from a state of one row; ``rng`` gives it variety.

        When the way has been gone without success, the expert is asked again, from where it got to: a
        grasp that failed is tried once more. No waypoints mean that it gives up.

        Raises:
            ConfigError: if the task has no expert.
        """
        raise ConfigError(
            f"{self.name} has no scripted expert. Learn it by reward, as in: "
            f"roboverse train policy=ppo task={self.name}"
        )

    @property
    def controller(self) -> "Controller":
        """What an action means; by default position targets of all joints of the first robot."""
        from envs.controllers import JointPositionController

        return JointPositionController(self.scenario.robots[0])

    @property
    def rl_controller(self) -> "Controller":
        """What an action of an agent that learns by reward means; every entry lies in [-1, 1].

        By default ways of the hand, where the task's own actions are targets of an arm's joints.
        """
        from envs.controllers import HandDeltaController, JointPositionController

        own = self.controller
        robot = self.scenario.robots[0]
        return HandDeltaController(robot) if isinstance(own, JointPositionController) else own

    def rl_observation(self, state: State) -> Tensor:
        """Returns what an agent that learns by reward sees, (N, D).

        By default positions, speeds and targets of the first robot's joints, and :meth:`observe`.
        """
        robot = state.robots[self.scenario.robots[0].name]
        assert robot.joint_target is not None, "a simulator gives every robot's targets"
        known = self.observe(state)
        if isinstance(known, Tensor):
            known = known.to(robot.joint_pos)
        return concatenate((robot.joint_pos, robot.joint_vel, robot.joint_target, known))

    @property
    def planner(self) -> "Planner":
        """What turns states into the expert's actions; by default inverse kinematics along its waypoints."""
        from envs.tasks.waypoint_planner import WaypointPlanner

        return WaypointPlanner(self.scenario, self.expert)

    def instruction(self, rng: np.random.Generator) -> str:
        """Draws one of the instructions."""
        return self.instructions[int(rng.integers(len(self.instructions)))]

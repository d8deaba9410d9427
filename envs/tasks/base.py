"""Base class of tasks: scenario, initial states, success, reward, observation and expert."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import chain
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import torch
from torch import Tensor

from envs.array_ops import concatenate
from envs.core.errors import ConfigError
from envs.joint_readings import joint_readings
from envs.scenario import RobotCfg, ScenarioCfg
from envs.state import State
from envs.tasks.parameters import check_parameters

if TYPE_CHECKING:
    from envs.controllers import Controller
    from envs.kinematics.waypoints import Waypoint
    from envs.randomization.language import WordingBank
    from envs.tasks.planner import Planner
    from envs.tasks.segment import Segment


class Task(ABC):
    """Pure functions of batched states, independent of the simulator.

    Subclasses are frozen dataclasses; their fields are the task's options. One that is made by
    :func:`~envs.tasks.parameters.parameter` is checked when the task is made.

    Attributes:
        name: Registered name.
        instructions: What to do, in words; an episode samples one.
        max_episode_steps: Control steps after which an episode is cut off.
        ends_on_success: Whether success ends an episode, with a reward of 1. If not, success is that of its
            last state, and every step has the dense reward.
        success_return: The return at which an episode counts as solved, checked when it is over; None uses
            :meth:`success` instead.
            has_expert: Whether there is a scripted expert.
            has_reward: Whether :meth:`reward` is dense.
        takes_arrays: Whether :meth:`success`, :meth:`failure`, :meth:`reward` and :meth:`observe` also take
            a state of numpy arrays, and then return arrays (see :mod:`envs.array_ops`), which is faster for
            few environments.
        mirrored_images: Whether a policy gets every image with left and right exchanged, as a benchmark's
            own environment gives it; videos are as the camera sees.
        segments: Subtasks of every demonstration, in order, for trajectory augmentation; none are found from
            recorded states.
    """

    name: ClassVar[str]
    instructions: ClassVar[tuple[str, ...]]
    max_episode_steps: ClassVar[int]
    ends_on_success: ClassVar[bool] = True
    success_return: ClassVar[float | None] = None
    has_expert: ClassVar[bool] = True
    has_reward: ClassVar[bool] = True
    takes_arrays: ClassVar[bool] = False
    mirrored_images: ClassVar[bool] = False
    segments: "ClassVar[tuple[Segment, ...]]" = ()

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def description(self) -> str:
        """The first of the instructions."""
        return self.instructions[0]

    @property
    @abstractmethod
    def scenario(self) -> ScenarioCfg:
        """The scene."""

    @property
    def robot(self) -> RobotCfg:
        """The robot that acts: the scene's first."""
        return self.scenario.robots[0]

    @property
    def robots(self) -> tuple[RobotCfg, ...]:
        """All robots that act, in the order of the scene, of an action and of a policy's state.

        By default it is :attr:`robot` alone. Where there are several, names of joints begin with their
        robot's, as in ``franka_left/joint1``.
        """
        return (self.robot,)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints of the robots that act, in order; those of one are as its file has them."""
        robots = self.robots
        if len(robots) == 1:
            return robots[0].joint_names
        return tuple(f"{robot.name}/{joint}" for robot in robots for joint in robot.joint_names)

    @property
    def reading_names(self) -> tuple[str, ...]:
        """Names of the readings of these joints; see :mod:`envs.joint_readings`."""
        robots = self.robots
        if len(robots) == 1:
            return robots[0].reading_names
        return tuple(f"{robot.name}/{name}" for robot in robots for name in robot.reading_names)

    def only_robot(self, purpose: str) -> RobotCfg:
        """Returns the robot of a task that has one.

        Args:
            purpose: What needs it, as the error says it.

        Raises:
            ConfigError: Several robots act.
        """
        if len(self.robots) > 1:
            raise ConfigError(
                f"{purpose} takes a task of one robot, and in {self.name} "
                f"{' and '.join(robot.name for robot in self.robots)} act together."
            )
        return self.robot

    @abstractmethod
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        """Draws one initial state per generator: a :class:`State` of ``len(rngs)`` rows, float64."""

    @abstractmethod
    def success(self, state: State) -> Tensor:
        """Returns whether the task is solved, (N,) bool. A state that is not finite is no success."""

    @property
    def num_fixed_starts(self) -> int:
        """Number of fixed starts, which the episodes of a split take in turn; 0 where each draws its own."""
        return 0

    def fixed_starts(self, indices: Sequence[int]) -> State:
        """Returns fixed starts, a row each; see :attr:`num_fixed_starts`."""
        raise NotImplementedError(f"{self.name} has no fixed starts.")

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the S entries of a policy's ``observation.state``; by default the joints' readings."""
        return self.reading_names

    @property
    def state_limits(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Least and largest value of each entry of :meth:`proprioception`."""
        # Joint limits are soft: a collision can push a joint a little beyond its range.
        parts = [
            joint_readings(robot).limits([(low - 1.0, high + 1.0) for low, high in _ranges(robot)])
            for robot in self.robots
        ]
        lows, highs = zip(*parts, strict=True)
        return tuple(chain.from_iterable(lows)), tuple(chain.from_iterable(highs))

    def proprioception(self, state: State) -> Tensor:
        """Returns a policy's ``observation.state``, (N, S); by default the joints' readings.

        They are positions, rad and m, unless a robot has units of its own.
        """
        robots = self.robots
        read = [joint_readings(robot).read(state.robots[robot.name].joint_pos) for robot in robots]
        return read[0] if len(read) == 1 else concatenate(read)

    def memory(self, state: State) -> "dict[str, tuple[Tensor, Tensor]]":
        """Returns poses that markers take after a step that led to each state; none by default.

        A rule that depends on what has happened in an episode reads it from markers. They are part of the
        state, so that it stays all there is to know: what is recorded, set or compared includes them.

        Returns:
            Name of a marker to positions (N, 3), m, and orientations (N, 4), wxyz.
        """
        del state
        return {}

    def failure(self, state: State) -> Tensor:
        """Returns whether the task has failed, which ends an episode, (N,) bool; never by default."""
        return torch.zeros(state.num_envs, dtype=torch.bool, device=state.device)

    @abstractmethod
    def reward(self, state: State) -> Tensor:
        """Returns the dense reward of a step that led to each state, (N,).

        Where success ends an episode its reward is 1, and that of all other states is in [0, 1).
        """

    @abstractmethod
    def observe(self, state: State) -> Tensor:
        """Returns the observation beside the joints of a policy without cameras, (N, D)."""

    def expert(self, state: State, rng: np.random.Generator) -> "list[Waypoint]":
        """Returns waypoints that solve the task from a state of one row; ``rng`` varies them.

        If the task is not solved at their end, the expert plans again from there, for instance to retry a
        failed grasp. An empty list means that it gives up.

        Raises:
            ConfigError: if the task has no expert.
        """
        raise ConfigError(
            f"{self.name} has no scripted expert. Use reinforcement learning, as in: "
            f"roboverse train policy=ppo task={self.name}"
        )

    def foreseen(self, state: State, rng: np.random.Generator) -> "list[Waypoint]":
        """Returns the path of the hand from a start of one row as far as it is known beforehand.

        By it another robot is put where it can reach everything (:mod:`envs.tasks.fit_robot`). By default it
        is the expert's first plan; a task whose expert plans again on the way adds what comes then.
        """
        return self.expert(state, rng) if self.has_expert else []

    @property
    def controller(self) -> "Controller":
        """The controller of actions; by default position targets of all joints of the robots that act."""
        from envs.controllers import JoinedController, JointPositionController

        parts = {robot.name: JointPositionController(robot) for robot in self.robots}
        return JoinedController(parts) if len(parts) > 1 else parts[self.robot.name]

    @property
    def rl_controller(self) -> "Controller":
        """The controller of actions in reinforcement learning; every entry is in [-1, 1].

        By default end-effector deltas, where the task's own actions are joint targets of an arm.
        """
        from envs.controllers import HandDeltaController, JoinedController, JointPositionController

        own = self.controller
        if not isinstance(own, JointPositionController | JoinedController):
            return own
        parts = {robot.name: HandDeltaController(robot) for robot in self.robots}
        return JoinedController(parts) if len(parts) > 1 else parts[self.robot.name]

    def rl_observation(self, state: State) -> Tensor:
        """Returns the observation of reinforcement learning, (N, D).

        By default positions, speeds and targets of each robot's joints, and :meth:`observe`.
        """
        parts: list[Tensor] = []
        for cfg in self.robots:
            robot = state.robots[cfg.name]
            assert robot.joint_target is not None, "a simulator gives every robot's targets"
            parts += (robot.joint_pos, robot.joint_vel, robot.joint_target)
        known = self.observe(state)
        if isinstance(known, Tensor):
            known = known.to(parts[0])
        return concatenate((*parts, known))

    @property
    def planner(self) -> "Planner":
        """The planner of the expert's actions; by default inverse kinematics along its waypoints."""
        from envs.tasks.waypoint_planner import WaypointPlanner

        return WaypointPlanner(self.scenario, self.expert)

    def instruction(self, rng: np.random.Generator) -> str:
        """Draws one of the instructions."""
        return self.instructions[int(rng.integers(len(self.instructions)))]

    def same_scene_tasks(self) -> tuple[str, ...]:
        """Returns registered names of other tasks that could be done in this one's scene; none by default.

        Their instructions are wrong here, and show whether a policy reads its own; see
        :func:`~envs.tasks.wrong_instructions.wrong_instructions`. A task whose success includes this one's
        is none of them.
        """
        return ()

    def wordings(self, instruction: str) -> "WordingBank":
        """Returns the wordings of an instruction that :meth:`instruction` drew: known and held-out ones.

        By default they are made from all of :attr:`instructions` by
        :func:`~envs.randomization.language.bank_of`. A task whose instructions mean different things makes
        them from the given one, ``bank_of((instruction,))``; a task may also list its own, as a
        :class:`~envs.randomization.language.WordingBank`.
        """
        from envs.randomization.language import bank_of

        return bank_of(self.instructions if instruction in self.instructions else (instruction,))


def _ranges(robot: RobotCfg) -> list[tuple[float, float]]:
    return [joint.range for joint in robot.joints]

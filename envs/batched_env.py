"""N environments of one task on one simulator: what the NumPy and the Torch environment share."""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np
from torch import as_tensor

from envs.array_ops import Array
from envs.controllers import Controller
from envs.simulators.base import EnvIds, Handler
from envs.state import State
from envs.tasks.base import Task
from envs.tasks.outcomes import Outcome, solved


class StepResult(NamedTuple):
    """The outcome of a control step of n environments; each array is (n,).

    Attributes:
        reward: Reward of the task.
        terminated: Whether success or failure ended the episode.
        truncated: Whether the time limit ended the episode.
        success: Whether the episode is solved.
    """

    reward: Array
    terminated: Array
    truncated: Array
    success: Array

    @property
    def over(self) -> Array:
        """Whether the episode is over: ``terminated`` or ``truncated``."""
        return self.terminated | self.truncated


class BatchedEnv(ABC):
    """Steps one task in N environments of a simulator, judges every step and counts steps and rewards.

    Subclasses keep ``elapsed_steps`` and ``returns`` as arrays of their own kind.

    Args:
        task: The task.
        handler: Its simulator, which is launched here.
        controller: Maps actions to joint targets.
        max_episode_steps: Time limit, control steps; the task's by default.

    Attributes:
        task: See above.
        handler: See above.
        controller: See above.
        max_episode_steps: See above.
        scenario: The scene that is simulated.
        num_envs: N.
        env_spec: The :class:`~envs.spec.EnvSpec` that made the environment; None if it was made from parts.
        elapsed_steps: Control steps of the present episodes, (N,) int64.
        returns: Sum of the task's rewards in the present episodes, (N,).
    """

    env_spec: Any = None
    num_envs: int
    elapsed_steps: Array
    returns: Array

    def __init__(
        self, task: Task, handler: Handler, controller: Controller, max_episode_steps: int | None = None
    ) -> None:
        self.task, self.handler, self.controller = task, handler, controller
        self.max_episode_steps = max_episode_steps or task.max_episode_steps
        self.scenario, self.num_envs = handler.scenario, handler.num_envs
        self._substeps = self.scenario.physics.decimation
        handler.launch()

    @abstractmethod
    def _judge(self, states: State) -> Outcome:
        """Returns the outcome of a step that led to ``states``, in this environment's kind of arrays."""

    def _present(self, env_ids: EnvIds = None) -> State:
        """Returns the present states of some environments."""
        return self.handler.get_states(env_ids)

    def _advance(self, actions: Array, env_ids: EnvIds = None) -> tuple[State, StepResult]:
        """Steps environments by one control step.

        Args:
            actions: Actions of the controller, (n, A).
            env_ids: Sorted ids of the environments; None means all.

        Returns:
            The states after the step, and its outcome.
        """
        self.controller.advance(self.handler, actions, self._substeps, env_ids)
        states = self._remembered(self._present(env_ids), env_ids)
        reward, terminated, success = self._judge(states)
        if env_ids is None:
            self.elapsed_steps += 1
            self.returns += reward
            elapsed, returns = self.elapsed_steps, self.returns
        else:
            self.elapsed_steps[env_ids] += 1
            self.returns[env_ids] += reward
            elapsed, returns = self.elapsed_steps[env_ids], self.returns[env_ids]
        timed_out = elapsed >= self.max_episode_steps
        success = solved(self.task, success, terminated | timed_out, returns)
        return states, StepResult(reward, terminated, timed_out & ~terminated, success)

    def _remembered(self, states: State, env_ids: EnvIds) -> State:
        """Moves the markers in which the task keeps what has happened; returns the states with them."""
        poses = self.task.memory(states)
        if not poses:
            return states
        tensors = {name: (as_tensor(pos), as_tensor(rot)) for name, (pos, rot) in poses.items()}
        self.handler.set_poses(tensors, env_ids)
        return self._present(env_ids)

    def _clear(self, env_ids: Array) -> None:
        """Resets the counters, and the controller, of environments whose episodes start."""
        self.controller.begin(env_ids)
        self.elapsed_steps[env_ids] = 0
        self.returns[env_ids] = 0.0

    @property
    def control_hz(self) -> float:
        """Control steps per second."""
        return self.scenario.physics.control_hz

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(camera.name for camera in self.scenario.cameras)

    @property
    def not_shown(self) -> tuple[str, ...]:
        """Properties of the appearance that the renderer does not show."""
        return self.handler.not_shown

    def get_states(self, env_ids: EnvIds = None) -> State:
        """Returns the states of some environments; None means all."""
        return self.handler.get_states(env_ids)

    def image(self, env_id: int = 0) -> np.ndarray:
        """Returns the first camera's image of one environment, (H, W, 3) uint8, whatever is observed."""
        camera = self.scenario.cameras[0].name
        return self.handler.render((camera,), ("rgb",), [env_id])[camera]["rgb"][0]

    def close(self) -> None:
        """Frees the simulator."""
        self.handler.close()

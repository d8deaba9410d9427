"""N environments of one task with tensors on one device, for reinforcement learning.

Shapes: N environments, D entries of an observation, A entries of an action, K initial states.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple, Protocol, override

import torch
from torch import Tensor

from envs.batched_env import BatchedEnv
from envs.core.errors import ConfigError
from envs.simulators.base import Handler
from envs.start_states import BANK_SIZE, expert_bank, initial_bank
from envs.state import State
from envs.tasks.base import Task
from envs.tasks.outcomes import Outcome, outcome


class EnvStep(NamedTuple):
    """The outcome of a control step of every environment.

    Attributes:
        obs: The next observation, (N, D): of the new episode where one is over.
        reward: The reward that the agent learns from, (N,).
        terminated: Success or failure ended the episode: no value follows it, (N,) bool.
        truncated: The time limit ended the episode: bootstrap the value of ``final_obs``, (N,) bool.
        final_obs: The last observation of the episode that the step belongs to, (N, D).
        success: Whether the episode is solved, (N,) bool.
    """

    obs: Tensor
    reward: Tensor
    terminated: Tensor
    truncated: Tensor
    final_obs: Tensor
    success: Tensor


class EpisodeStatistics(NamedTuple):
    """Means over the episodes that ended since the last call.

    Attributes:
        episodes: Their number; the means are NaN where it is 0.
        episode_return: Return of the task's own reward.
        length: Control steps.
        success_rate: Share that was solved.
        by_task: The same for each task by its name, where there are several.
    """

    episodes: int
    episode_return: float
    length: float
    success_rate: float
    by_task: "Mapping[str, EpisodeStatistics]" = MappingProxyType({})

    def means(self) -> dict[str, float]:
        """Returns the means by name, for logs; those of one task as in ``success_rate/PickCube``."""
        own = {
            "episode_return": self.episode_return,
            "episode_length": self.length,
            "success_rate": self.success_rate,
        }
        return (own if self.episodes else {}) | {
            f"{name}/{task}": value
            for task, statistics in self.by_task.items()
            for name, value in statistics.means().items()
        }


class TorchEnv(Protocol):
    """The interface of an environment with tensors, which the adapters in :mod:`envs.adapters` take."""

    num_envs: int
    device: torch.device
    observation_size: int
    action_size: int
    max_episode_steps: int
    elapsed_steps: Tensor

    def reset(self, mask: Tensor | None = None) -> Tensor:
        """Starts new episodes everywhere, or where ``mask`` (N,) says so; returns observations (N, D)."""
        ...

    def step(self, actions: Tensor) -> EnvStep:
        """Steps every environment."""
        ...

    def seed(self, seed: int) -> None:
        """Seeds the initial states."""
        ...

    def close(self) -> None:
        """Frees the simulator."""
        ...


class TorchVectorEnv(BatchedEnv):
    """N environments of one task that are stepped together, with tensors in and out.

    An episode starts at one of K initial states sampled once, or, for a share of the episodes, at a
    state on the expert's path. An environment whose episode is over restarts in the same step. Actions are
    those of the task's ``rl_controller``, in [-1, 1]. The task's reward is at most 1 and success ends an
    episode with 1; with ``shift_reward`` an agent gets the reward less 1, so that it has no reason to put
    success off, and a failure costs as much as no reward until the time limit. Make one with
    :meth:`envs.spec.EnvSpec.make_torch`.

    Args:
        task: The task.
        handler: Its simulator, not yet launched.
        split: Which episodes, one of :data:`~envs.randomization.splits.SPLIT_NAMES`.
        device: Device of returned tensors; the simulator's by default.
        seed: Seeds the initial states.
        max_episode_steps: Time limit, control steps; the task's by default.
        shift_reward: See above.
        protocol_seed: Seed of the episodes.
        bank_size: K.
        expert_starts: Share of the episodes that start on the expert's path; see :mod:`envs.start_states`.

    Attributes:
        device: See above.
        action_size: A.
        observation_shape: Shape of one environment's observation, (D,).
        observation_size: D.

    Raises:
        ConfigError: ``expert_starts`` is no share, or the task has no expert.
    """

    def __init__(
        self,
        task: Task,
        handler: Handler,
        *,
        split: str = "train",
        device: str | torch.device | None = None,
        seed: int = 0,
        max_episode_steps: int | None = None,
        shift_reward: bool = True,
        protocol_seed: int = 0,
        bank_size: int = BANK_SIZE,
        expert_starts: float = 0.0,
    ) -> None:
        if not 0.0 <= expert_starts <= 1.0:
            raise ConfigError(f"expert_starts is a share from 0 to 1, given {expert_starts}.")
        super().__init__(task, handler, task.rl_controller, max_episode_steps)
        self.device = torch.device(device) if device is not None else handler.device
        self.action_size = len(self.controller.names)
        self._shift = shift_reward and task.ends_on_success
        self._bank = initial_bank(task, handler, split, protocol_seed, bank_size)
        self._expert_share, self._expert_bank = expert_starts, None
        if expert_starts:
            self._expert_bank = expert_bank(task, handler, split, protocol_seed, self._substeps)
        zeros = torch.zeros(self.num_envs, device=self.device)
        self.elapsed_steps, self.returns = zeros.long(), zeros.clone()
        self._sums = torch.zeros(4, device=self.device, dtype=torch.float64)
        self.seed(seed)
        self.observation_shape = tuple(self.reset().shape[1:])
        self.observation_size = math.prod(self.observation_shape)

    def seed(self, seed: int) -> None:
        """Seeds the initial states."""
        self._generator = torch.Generator(self.handler.device).manual_seed(seed)

    def random_state(self) -> Tensor:
        """Returns the state of the generator of initial states."""
        return self._generator.get_state()

    def set_random_state(self, state: Tensor) -> None:
        """Restores a state that :meth:`random_state` returned."""
        self._generator.set_state(state)

    @torch.no_grad()
    def reset(self, mask: Tensor | None = None) -> Tensor:
        """Starts new episodes everywhere, or where ``mask`` (N,) is true; returns observations (N, D)."""
        ids = torch.arange(self.num_envs) if mask is None else mask.nonzero()[:, 0]
        if len(ids):
            self._restart(ids)
        return self._observe_started(ids)

    @torch.no_grad()
    def step(self, actions: Tensor) -> EnvStep:
        """Steps every environment by one control step; ``actions`` (N, A) in [-1, 1]."""
        states, result = self._advance(actions.detach().clamp(-1.0, 1.0).to(self.handler.device))
        obs = final_obs = self._observe(states)
        reward = result.reward
        if self._shift:
            left = (self.max_episode_steps - self.elapsed_steps) * (result.terminated & ~result.success)
            reward = reward - 1.0 - left
        over = result.over
        self._count(over, result.success)
        ids = over.nonzero()[:, 0]  # the only host synchronization
        if len(ids):
            self._restart(ids)
            obs = self._observe_started(ids)
        return EnvStep(obs, reward, result.terminated, result.truncated, final_obs, result.success)

    @override
    def _judge(self, states: State) -> Outcome:
        reward, terminated, success = (values.to(self.device) for values in outcome(self.task, states))
        return Outcome(reward.float(), terminated, success)

    def _count(self, over: Tensor, success: Tensor) -> None:
        done = over.double()
        rows = (done, done * self.returns, done * self.elapsed_steps, done * success)
        self._sums += torch.stack([row.sum() for row in rows])

    def pop_statistics(self) -> EpisodeStatistics:
        """Returns the statistics of the episodes that ended since the last call, and resets them."""
        count, *sums = self._sums.tolist()
        self._sums.zero_()
        returns, length, success = (value / count if count else float("nan") for value in sums)
        return EpisodeStatistics(int(count), returns, length, success)

    def _restart(self, ids: Tensor) -> None:
        """Starts episodes in the environments ``ids``."""
        if self._expert_bank is None:
            self._place(ids, self._bank)
        else:
            draws = torch.rand(len(ids), generator=self._generator, device=self.handler.device)
            late = (draws < self._expert_share).to(ids.device)
            self._place(ids[~late], self._bank)
            self._place(ids[late], self._expert_bank)
        self._clear(ids.to(self.device))

    def _place(self, ids: Tensor, bank: State) -> None:
        """Sets environments to states sampled from a bank."""
        if not len(ids):
            return
        device = self.handler.device
        rows = torch.randint(bank.num_envs, (len(ids),), generator=self._generator, device=device)
        self.handler.set_states(bank.select(rows), ids)

    def stagger(self) -> None:
        """Sets random elapsed steps, so that not all episodes end at once."""
        generator = torch.Generator(self.device).manual_seed(int(self._generator.initial_seed()))
        self.elapsed_steps = torch.randint(
            self.max_episode_steps, (self.num_envs,), generator=generator, device=self.device
        )

    def state_dict(self) -> dict[str, Tensor]:
        """Returns the state of every environment, for :meth:`load_state_dict`."""
        states = self.handler.get_states().flatten()
        flat = {f"states/{key}": value.clone() for key, value in states.items()}  # some may share memory
        return flat | {"elapsed_steps": self.elapsed_steps.clone(), "returns": self.returns.clone()}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> Tensor:
        """Restores every environment's state; returns observations (N, D)."""
        of_handler = {key.removeprefix("states/"): value for key, value in state.items() if "/" in key}
        self.handler.set_states(State.unflatten(of_handler).to(self.handler.device, self.handler.dtype))
        self.elapsed_steps = state["elapsed_steps"].to(self.device, copy=True)
        self.returns = state["returns"].to(self.device, copy=True)
        return self._observe(self.handler.get_states())

    def _observe(self, states: State) -> Tensor:
        """Returns the observations after a step that led to ``states``, (N, D)."""
        return self.task.rl_observation(states).to(device=self.device, dtype=torch.float32)

    def _observe_started(self, ids: Tensor) -> Tensor:
        """Returns all observations (N, D) after episodes started in the environments ``ids``."""
        del ids
        return self._observe(self.handler.get_states())

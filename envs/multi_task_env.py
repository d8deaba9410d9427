"""Several tasks as one batch of environments, for multi-task reinforcement learning.

Shapes: N environments of T tasks, D entries of the largest observation, A entries of the largest action.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from envs.core.errors import ConfigError
from envs.torch_env import EnvStep, EpisodeStatistics


class MultiTaskEnv:
    """One batched environment per task: the first rows are of the first task, and so on.

    Observations of smaller tasks are padded with zeros to the largest one, (N, D). A task uses the first
    entries of an action (N, A), as many as it has. Random numbers of a task do not depend on the others.

    Args:
        envs: Task to its :class:`~envs.torch_env.TorchVectorEnv`, or an environment with its interface;
            observations are vectors.

    Attributes:
        envs: See above, in order.
        task_ids: Index of each environment's task, (N,) int64.
        max_episode_steps: The longest time limit of a task, control steps.

    Raises:
        ConfigError: There is no task.
    """

    def __init__(self, envs: Mapping[str, Any]) -> None:
        if not envs:
            raise ConfigError("MultiTaskEnv needs at least one task, given none.")
        self.envs = dict(envs)
        each = list(self.envs.values())
        self.device: torch.device = each[0].device
        self._sizes: list[int] = [env.num_envs for env in each]
        self.num_envs = sum(self._sizes)
        self.observation_size: int = max(env.observation_size for env in each)
        self.action_size: int = max(env.action_size for env in each)
        self.max_episode_steps: int = max(env.max_episode_steps for env in each)
        counts = torch.tensor(self._sizes, device=self.device)
        self.task_ids = torch.arange(len(each), device=self.device).repeat_interleave(counts)

    def seed(self, seed: int) -> None:
        """Seeds the initial states, differently for each task."""
        for index, env in enumerate(self.envs.values()):
            env.seed(int(np.random.SeedSequence(seed, spawn_key=(index,)).generate_state(1)[0]))

    def random_state(self) -> Tensor:
        """Returns the states of the tasks' generators, (T, …)."""
        return torch.stack([env.random_state() for env in self.envs.values()])

    def set_random_state(self, state: Tensor) -> None:
        """Restores states that :meth:`random_state` returned."""
        for env, own in zip(self.envs.values(), state, strict=True):
            env.set_random_state(own.clone())  # torch reads from the start of the storage

    def reset(self, mask: Tensor | None = None) -> Tensor:
        """Starts new episodes everywhere, or where ``mask`` (N,) is true; returns observations (N, D)."""
        masks = [None] * len(self.envs) if mask is None else mask.split(self._sizes)
        return self._padded(env.reset(own) for env, own in zip(self.envs.values(), masks, strict=True))

    def step(self, actions: Tensor) -> EnvStep:
        """Steps every environment by one control step; ``actions`` (N, A) in [-1, 1]."""
        steps = [
            env.step(own[:, : env.action_size])
            for env, own in zip(self.envs.values(), actions.split(self._sizes), strict=True)
        ]
        return EnvStep(
            obs=self._padded(step.obs for step in steps),
            reward=torch.cat([step.reward for step in steps]),
            terminated=torch.cat([step.terminated for step in steps]),
            truncated=torch.cat([step.truncated for step in steps]),
            final_obs=self._padded(step.final_obs for step in steps),
            success=torch.cat([step.success for step in steps]),
        )

    def pop_statistics(self) -> EpisodeStatistics:
        """Returns the statistics of all tasks and of each since the last call, and resets them."""
        by_task = {name: env.pop_statistics() for name, env in self.envs.items()}
        ended = [own for own in by_task.values() if own.episodes]
        episodes = sum(own.episodes for own in ended)

        def mean(name: str) -> float:
            total = sum(own.episodes * getattr(own, name) for own in ended)
            return total / episodes if episodes else float("nan")

        return EpisodeStatistics(
            episodes, mean("episode_return"), mean("length"), mean("success_rate"), by_task
        )

    def state_dict(self) -> dict[str, Tensor]:
        """Returns the state of every environment, for :meth:`load_state_dict`."""
        return {
            f"{index}.{key}": value
            for index, env in enumerate(self.envs.values())
            for key, value in env.state_dict().items()
        }

    def load_state_dict(self, state: Mapping[str, Tensor]) -> Tensor:
        """Restores every environment's state; returns observations (N, D)."""
        parts: list[dict[str, Tensor]] = [{} for _ in self.envs]
        for key, value in state.items():
            index, _, own = key.partition(".")
            parts[int(index)][own] = value
        return self._padded(
            env.load_state_dict(own) for env, own in zip(self.envs.values(), parts, strict=True)
        )

    def close(self) -> None:
        """Frees the simulators."""
        for env in self.envs.values():
            env.close()

    def _padded(self, observations: Iterator[Tensor]) -> Tensor:
        """Returns the observations of all tasks as one tensor (N, D)."""
        size = self.observation_size
        return torch.cat([functional.pad(each, (0, size - each.shape[1])) for each in observations])

"""A task that is checked: its environment and its expert's episodes, made when they are first asked for."""

from functools import cached_property
from typing import Any

import numpy as np

from envs.experts.actor import expert_episodes
from envs.rollout import Episode
from envs.spec import EnvSpec
from envs.tasks import TASKS
from envs.tasks.base import Task
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.checks.contract import NotApplicableError


class CheckedTask:
    """A task under test. Close it when it is done with.

    Args:
        spec: The environment; its images are rendered only where a contract looks at them.
        num_envs: Environments that step at once.
        episodes: Starts of the test split that the expert is given.
        required: Share of them that it must solve.
    """

    def __init__(
        self, spec: EnvSpec, *, num_envs: int = 3, episodes: int = 20, required: float = 0.8
    ) -> None:
        self.spec, self.num_envs, self.episodes, self.required = spec, num_envs, episodes, required

    @cached_property
    def task_class(self) -> type[Task]:
        """What is registered under the task's name."""
        return TASKS.get(self.spec.task)

    @cached_property
    def task(self) -> Task:
        """The task with its options and its changed scene."""
        return self.spec.make_task()

    @cached_property
    def env(self) -> RoboVerseVectorEnv:
        """``num_envs`` environments of the test split, whose observations are states."""
        return self.make(self.num_envs)

    def make(self, num_envs: int) -> RoboVerseVectorEnv:
        """Returns more such environments; whoever makes them closes them."""
        cameras = self.spec.cameras or tuple(camera.name for camera in self.task.scenario.cameras)
        return self.spec.replace(cameras=cameras).make(num_envs, split="test", observation="state")

    def start(self) -> None:
        """Begins the first episodes of the split in :attr:`env`."""
        self.env.reset_envs(range(self.num_envs), self.env.split_indices[: self.num_envs])

    def observed_starts(self, count: int) -> np.ndarray:
        """Returns what is observed beside the joints at the first starts of the split, (count, D)."""
        rows = []
        for first in range(0, count, self.num_envs):
            ids = np.arange(min(self.num_envs, count - first))
            self.env.reset_envs(ids, self.env.split_indices[first : first + len(ids)])
            rows.append(self.env.observe(ids)["observation.environment_state"])
        return np.concatenate(rows)

    def random_actions(self, rng: np.random.Generator) -> np.ndarray:
        """Draws actions within their limits, (num_envs, A) float32."""
        space: Any = self.env.single_action_space
        return rng.uniform(space.low, space.high, (self.num_envs, *space.shape)).astype(np.float32)

    @cached_property
    def rollouts(self) -> list[Episode]:
        """The expert's episodes, with states.

        Raises:
            NotApplicableError: The task has no expert.
        """
        if not self.task.has_expert:
            raise NotApplicableError(f"{self.task.name} has no expert")
        return list(
            expert_episodes(self.env, self.env.split_indices[: self.episodes].tolist(), record=("states",))
        )

    def close(self) -> None:
        """Frees the simulator."""
        if "env" in self.__dict__:
            self.env.close()

"""Demonstrations of a task's scripted expert."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, override

import numpy as np

from envs.array_ops import to_numpy
from envs.core.errors import ConfigError
from envs.spec import EnvSpec
from roboverse_learn.data.dataset.schema import EpisodeData
from roboverse_learn.data.sources.base import DemonstrationSource, spec_changes
from roboverse_learn.data.sources.changing_looks import changing_looks


class ExpertSource(DemonstrationSource):
    """``source=expert``."""

    episodes: ClassVar = "roboverse_learn.data.sources.expert:ExpertEpisodes"
    native_observations: ClassVar = True
    changes_looks: ClassVar = True

    @override
    def check(self) -> None:
        from envs.tasks import TASKS

        task = self.config.env.task
        if not TASKS.get(task).has_expert:
            raise ConfigError(
                f"{task} has no scripted expert to collect from. Train it by reinforcement learning, as in: "
                f"roboverse train policy=ppo task={task}"
            )

    @override
    def advice_for_task(self) -> str:
        return f"Measure the expert with: python -m envs.experts.check task={self.config.env.task}"


class ExpertEpisodes:
    """Runs the expert in a batch of environments of the train split.

    Args:
        env: JSON values of an :class:`~envs.spec.EnvSpec`.
        num_envs: Environments that step at once.
        steps_per_look: Control steps after which an episode's look changes; 0 keeps it.
    """

    def __init__(self, *, env: Mapping[str, Any], num_envs: int, steps_per_look: int = 0) -> None:
        from benchmark.provenance import package_versions

        spec = EnvSpec.from_json(env)
        self._env = spec.make(num_envs, num_threads=1)  # the processes of a collection share the cores
        self._on_step = changing_looks(self._env, steps_per_look)
        self._metadata = {
            "task": spec.task,
            "task_kwargs": dict(spec.task_kwargs),
            "level": None if spec.only else spec.level,
            "only": spec.only,
            "channels": list(self._env.channels),
            "not_shown": list(self._env.not_shown),
            "split": "train",
            "simulator": spec.simulator,
            "renderer": spec.renderer,
            "protocol_seed": self._env.protocol_seed,
            "versions": package_versions(),
        } | spec_changes(spec)
        if steps_per_look:
            self._metadata["steps_per_look"] = steps_per_look

    def attempts(self, indices: Sequence[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        """Runs the expert on pool episodes, at most ``num_envs`` of them."""
        from envs.experts.actor import expert_episodes

        for outcome in expert_episodes(self._env, list(indices), on_step=self._on_step):
            yield int(outcome.episode), self._episode(outcome) if outcome.success else None

    def close(self) -> None:
        """Releases the simulator."""
        self._env.close()

    def _episode(self, outcome: Any, **facts: Any) -> EpisodeData:
        own = {
            "episode": int(outcome.episode),
            "success": True,
            "initial_state_hash": outcome.initial_state_hash,
        }
        images = outcome.images
        if self._env.task.mirrored_images:
            images = {name: self._env.as_observed(images[name]) for name in images}
        return EpisodeData(
            # What a policy would have observed, by the function that live observations come from.
            states=to_numpy(self._env.task.proprioception(outcome.states))[:-1].astype(np.float32),
            actions=outcome.actions,
            images=images,
            task=outcome.instruction,
            raw=outcome.raw,
            metadata=self._metadata | own | facts,
        )

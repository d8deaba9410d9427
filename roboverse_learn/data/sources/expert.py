"""Demonstrations of a task's expert, as the collection wants them."""

from collections.abc import Iterator, Sequence
from typing import Any

from benchmark.provenance import package_versions
from roboverse_learn.data.dataset.schema import EpisodeData


class ExpertSource:
    """Runs the expert in a batch of environments of the train split.

    Args:
        task: Registered task.
        task_kwargs: Options of the task.
        num_envs: Environments that step at once.
        level: Level, or None when one channel varies alone.
        only: The channel that varies alone, or None.
        simulator: Registered simulator.
        renderer: Registered renderer.
        cameras: Cameras that are observed; empty is the task's first.
        image_size: Pixels a side.
        materials: Folder of pictures in place of the built-in materials, with ``+`` before it beside them.
        simulator_settings: Settings of the simulator that replace the scene's.
        scenario: What is changed of the task's scene.
    """

    def __init__(
        self,
        *,
        task: str,
        task_kwargs: dict[str, Any],
        num_envs: int,
        level: int,
        only: str | None,
        simulator: str,
        renderer: str,
        cameras: Sequence[str],
        image_size: int,
        materials: str | None = None,
        simulator_settings: dict[str, Any] | None = None,
        scenario: dict[str, Any] | None = None,
    ) -> None:
        import envs

        self._env = envs.make_vec(
            task,
            num_envs,
            level=level,
            only=only,
            split="train",
            simulator=simulator,
            renderer=renderer,
            cameras=cameras,
            image_size=image_size,
            task_kwargs=task_kwargs,
            materials=materials,
            simulator_settings=simulator_settings,
            scenario=scenario,
            num_threads=1,  # the processes of a collection share the cores
        )
        self._metadata = {
            "task": task,
            "task_kwargs": task_kwargs,
            "level": None if only else level,
            "only": only,
            "channels": list(self._env.channels),
            "not_shown": list(self._env.not_shown),
            "split": "train",
            "simulator": simulator,
            "renderer": renderer,
            "protocol_seed": self._env.protocol_seed,
            "versions": package_versions(),
        }
        tuning = {"simulator_settings": simulator_settings, "scenario": scenario}
        self._metadata |= {key: values for key, values in tuning.items() if values}

    def attempts(self, indices: Sequence[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        """Runs the expert on pool episodes, at most ``num_envs`` of them."""
        from envs.experts.actor import expert_episodes

        for outcome in expert_episodes(self._env, list(indices)):
            yield int(outcome.episode), self._episode(outcome) if outcome.success else None

    def close(self) -> None:
        """Releases the simulator."""
        self._env.close()

    def _episode(self, outcome: Any, **facts: Any) -> EpisodeData:
        return EpisodeData(
            states=outcome.observation_state,
            actions=outcome.actions,
            images=outcome.images,
            task=outcome.instruction,
            raw=outcome.raw,
            metadata=self._metadata
            | {
                "episode": int(outcome.episode),
                "success": True,
                "initial_state_hash": outcome.initial_state_hash,
            }
            | facts,
        )


def make_expert_source(**kwargs: Any) -> ExpertSource:
    """Builds an :class:`ExpertSource`: what collecting processes call by name."""
    return ExpertSource(**kwargs)

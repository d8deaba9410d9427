"""Stored episodes of a dataset, rendered again: at another level, and as often as wanted.

The physics ran once, when the dataset was collected. Here its states are set and rendered, which costs the
images alone. The first look of an episode is that of its own index in the pool, so at the level of the
dataset it gives the same images; each further look has the appearance of an index that no episode of the
dataset has.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar, override

from envs.playback import PlaybackEnv, ReplayActor
from envs.rollout import in_order, rollout
from roboverse_learn.data.dataset.recorded_scene import check_not_merged, check_same_scene, pool_indices
from roboverse_learn.data.dataset.recording import RecordingReader
from roboverse_learn.data.dataset.schema import EpisodeData
from roboverse_learn.data.sources.expert import ExpertEpisodes
from roboverse_learn.data.sources.made_from import MadeFromDataset

_SAME = ("task", "task_kwargs", "robot", "scenario")
"""Fields of the environment in which the states must have been recorded."""


class RerenderSource(MadeFromDataset):
    """``source=rerender from=<dataset>``."""

    episodes: ClassVar = "roboverse_learn.data.sources.rerender:RerenderedEpisodes"
    native_observations: ClassVar = True
    changes_looks: ClassVar = True
    needs: ClassVar = {
        "from_dataset": "<folder>: a dataset with raw states, as in from=datasets/PickCube/<name>."
    }

    @classmethod
    @override
    def task_of(cls, values: Mapping[str, Any]) -> str | None:
        folder = values["from_dataset"]
        return RecordingReader(folder).read(0).metadata["task"] if folder else None

    @cached_property
    def _looks(self) -> "Looks":
        return Looks.of(RecordingReader(self.config.from_dataset), super().candidates())

    @override
    def check(self) -> None:
        config, env = self.config, self.config.env
        recordings = RecordingReader(config.from_dataset)
        check_not_merged(config.from_dataset, recordings.info.episode_metadata)
        check_same_scene(config.from_dataset, recordings.read(0).metadata, env, _SAME)

    @override
    def candidates(self) -> list[int]:
        return self._looks.indices

    @override
    def outcome(self, num_kept: int, num_attempts: int) -> str:
        return f"{num_kept} of {num_attempts} looks show a success"

    @override
    def arguments(self) -> dict[str, Any]:
        return super().arguments() | self.identity() | {"path": str(self.config.from_dataset)}


class Looks:
    """Which recorded episode is rendered with the appearance of which pool index.

    Args:
        own: Pool index of each recorded episode, in the order of the dataset.
        pool: All indices of the train split, in order.
    """

    def __init__(self, own: Sequence[int], pool: Sequence[int]) -> None:
        taken = set(own)
        self.num_recordings = len(own)
        self.indices = [*own, *(index for index in pool if index not in taken)]
        self._position = {index: position for position, index in enumerate(self.indices)}

    @classmethod
    def of(cls, recordings: RecordingReader, pool: Sequence[int]) -> "Looks":
        """Returns the looks of a dataset.

        Raises:
            DatasetError: An episode is of the test split or of no pool, or two have one index.
        """
        return cls(pool_indices(recordings), pool)

    def recording_of(self, index: int) -> tuple[int, int]:
        """Returns the recorded episode that takes an index's appearance, and which of its looks this is."""
        look, recording = divmod(self._position[index], self.num_recordings)
        return recording, look


class RerenderedEpisodes(ExpertEpisodes):
    """Renders recorded states with the appearance of episodes of the train split.

    Args:
        path: Folder of the dataset.
        source: ``"rerender"``.
        dataset: First digits of the dataset's hash.
        scene: See :class:`~roboverse_learn.data.sources.expert.ExpertEpisodes`.
    """

    def __init__(self, *, path: str, source: str, dataset: str, **scene: Any) -> None:
        super().__init__(**scene)
        from envs.randomization.splits import load_split

        self._recordings = RecordingReader(path)
        self._looks = Looks.of(self._recordings, load_split("train").episodes.tolist())
        self._facts = {"source": source, "dataset": dataset}

    @override
    def attempts(self, indices: Sequence[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        places = [self._looks.recording_of(index) for index in indices]
        recordings = [self._recordings.read(episode) for episode, _ in places]
        scene = self._env.scenario
        # A channel of the dataset may have added objects, which this scene shows only if it varies too.
        known = {item.name for item in (*scene.robots, *scene.objects)}
        states = [recording.states.within(known) for recording in recordings]
        actor = ReplayActor(
            [each.select([0]) for each in states],
            [recording.actions for recording in recordings],
            hold_steps=0,
            tail_steps=math.inf,
        )
        env = PlaybackEnv(self._env, states)
        outcomes = in_order(rollout(env, actor, indices, record=("images", "states"), on_step=self._on_step))
        for recording, (_, look), outcome in zip(recordings, places, outcomes, strict=True):
            facts = self._facts | source_facts(recording.metadata, look)
            yield int(outcome.episode), self._episode(outcome, **facts) if outcome.success else None


def source_facts(metadata: Mapping[str, Any], look: int) -> dict[str, Any]:
    """Returns where a rendered episode comes from; a first look is the recorded episode itself."""
    facts = {"simulator": metadata["simulator"], "look": look}
    return facts | ({"source_episode": metadata["episode"]} if look else {})

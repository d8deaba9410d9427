"""Demonstrations of another robot: the path of its hand, followed by this one in physics.

What is followed are the hand poses that the recorded joint targets command. An episode begins with the
objects of its recording and with the robot as the task samples it, and is kept where the task's success rule
holds.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, override

from envs.core.errors import ConfigError
from roboverse_learn.data.dataset.recorded_scene import (
    check_not_merged,
    check_same_scene,
    pool_indices,
    recorded_spec,
    task_of,
)
from roboverse_learn.data.dataset.recording import RecordingReader
from roboverse_learn.data.dataset.schema import EpisodeData
from roboverse_learn.data.sources.expert import ExpertEpisodes
from roboverse_learn.data.sources.made_from import MadeFromDataset


class RetargetSource(MadeFromDataset):
    """``source=retarget from=<dataset> robot=<another>``: one episode for each of the dataset at most."""

    episodes: ClassVar = "roboverse_learn.data.sources.retarget:RetargetedEpisodes"
    num_demos_is_most: ClassVar = True
    needs: ClassVar = {
        "from_dataset": "<folder>: a dataset of another robot, as in from=datasets/PickCube/<name>."
    }

    @classmethod
    @override
    def task_of(cls, values: Mapping[str, Any]) -> str | None:
        return task_of(values["from_dataset"]) if values["from_dataset"] else None

    @cached_property
    def _recordings(self) -> RecordingReader:
        return RecordingReader(self.config.from_dataset)

    @override
    def check(self) -> None:
        from roboverse_learn.data.retargeting.hand_path import check_hands

        config, env = self.config, self.config.env
        recorded = self._recordings.read(0).metadata
        every = self._recordings.info.episode_metadata
        check_not_merged(config.from_dataset, every)
        for metadata in every:
            check_same_scene(config.from_dataset, metadata, env)
        source, task = recorded_spec(recorded).make_task(), env.make_task()
        if source.robot.name == task.robot.name:
            raise ConfigError(
                f"The dataset '{config.from_dataset}' is of '{source.robot.name}' already. Give another "
                "robot, as in robot=ur5e; those there are: roboverse list robots"
            )
        check_hands(task, (source.robot, task.robot))
        pool_indices(self._recordings)

    @override
    def candidates(self) -> list[int]:
        return pool_indices(self._recordings)

    @override
    def arguments(self) -> dict[str, Any]:
        return super().arguments() | self.identity() | {"path": str(Path(self.config.from_dataset).resolve())}

    @override
    def outcome(self, num_kept: int, num_attempts: int) -> str:
        share = 100 * num_kept / max(num_attempts, 1)
        said = f"{num_kept} of {num_attempts} retargeted demonstrations were kept ({share:.1f} %)"
        held, wanted = len(self._recordings), self.config.collect.num_demos
        if wanted <= held or wanted == type(self.config.collect)().num_demos:  # nobody asked for so many
            return said
        return (
            f"{said}; num_demos={wanted} is not reached: from={self.config.from_dataset} holds {held} "
            "demonstrations, and each gives one at most"
        )

    @override
    def advice_for_task(self) -> str:
        return "Try another robot, or run the task's expert on this one: source=expert."


class RetargetedEpisodes(ExpertEpisodes):
    """Follows the hand paths of a dataset in a batch of environments of the train split.

    Args:
        path: Folder of the dataset.
        source: ``"retarget"``.
        dataset: First digits of the dataset's hash.
        scene: See :class:`~roboverse_learn.data.sources.expert.ExpertEpisodes`.
    """

    def __init__(self, *, path: str, source: str, dataset: str, **scene: Any) -> None:
        from roboverse_learn.data.retargeting.hand_path import HandPathReader
        from roboverse_learn.data.retargeting.planner import RetargetPlanner

        super().__init__(**scene)
        self._recordings = RecordingReader(path)
        self._position = {index: row for row, index in enumerate(pool_indices(self._recordings))}
        robot = recorded_spec(self._recordings.read(0).metadata).make_task().robot
        self._reader = HandPathReader(robot)
        self._planner = RetargetPlanner(self._env.task, at_once=self._env.handler.steps_together)
        self._facts = {"source": source, "dataset": dataset, "source_robot": robot.name}

    @override
    def attempts(self, indices: Sequence[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        from roboverse_learn.data.retargeting.actor import retargeted_episodes

        recordings = [self._recordings.read(self._position[index]) for index in indices]
        starts = [recording.states.select([0]) for recording in recordings]
        paths = [self._reader.read(recording.states) for recording in recordings]
        outcomes = retargeted_episodes(self._env, indices, self._planner, starts, paths)
        for recording, outcome in zip(recordings, outcomes, strict=True):
            facts = self._facts | {
                "demonstration": recording.index,
                "max_error_m": round(outcome.memory.missed_m, 6),
                "max_error_rad": round(outcome.memory.missed_rad, 6),
            }
            yield int(outcome.episode), self._episode(outcome, **facts) if outcome.success else None

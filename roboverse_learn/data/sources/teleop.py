"""Demonstrations of a person: recorded states, rendered with any camera, renderer and level."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, override

import numpy as np
import torch

from envs.core.errors import ConfigError, DatasetError
from envs.core.fingerprint import file_hash
from envs.spec import EnvSpec
from envs.state import State
from roboverse_learn.data.collection.schedule import check_settings
from roboverse_learn.data.dataset.info import DatasetInfo, is_collected_here, read_info
from roboverse_learn.data.dataset.recorded_scene import robot_of, what_to_give
from roboverse_learn.data.dataset.schema import EpisodeData
from roboverse_learn.data.importers.demonstration import Demonstration
from roboverse_learn.data.importers.replayer import Replay, Replayer
from roboverse_learn.data.sources.base import DemonstrationSource, Progress
from roboverse_learn.data.sources.expert import ExpertEpisodes
from roboverse_learn.teleoperation.recording import Mark, Recording, open_recordings, scene_of

_FACTS = ("operator", "device", "seconds", "path_m", "idle_share", "policy", "weights")


class TeleopSource(DemonstrationSource):
    """``source=teleop``: the successes of a folder of ``roboverse teleoperate``.

    Each is rendered as the episode of the train split that it was steered in. A dataset grows with its
    folder: recordings that were added are added to it, too.
    """

    episodes: ClassVar = "roboverse_learn.data.sources.teleop:TeleopEpisodes"
    needs: ClassVar = {"path": "<folder>: the recordings of roboverse teleoperate."}
    num_demos_is_most: ClassVar = True
    columns: ClassVar = ("success", "intervention")
    corrects: ClassVar = True

    @override
    def check(self) -> None:
        path = Path(self.config.path)
        if self.config.only_corrections and self.config.replay != "states":
            raise ConfigError(
                "only_corrections=true begins in the middle of a recording, whose state replay="
                f"{self.config.replay} does not reach. Leave out replay=."
            )
        for facts in open_recordings(path).values():
            _check_scene(path, facts["scene"], self.config.env)
        if not self._files():
            what = "success with a correction" if self.config.only_corrections else "success"
            raise DatasetError(f"path={path}: no recording is marked as a {what}. Steer some more episodes.")

    @override
    def prepare(self, dataset: Path, progress: Progress) -> None:
        """Refuses a dataset with an episode that was discarded since."""
        if not is_collected_here(dataset) or not read_info(dataset)["total_episodes"]:
            return
        kept = self._files()
        for facts in DatasetInfo.open(dataset).episode_metadata:
            if kept.get(facts["episode"], Path()).name != facts.get("file"):
                raise DatasetError(
                    f"The dataset '{dataset}' holds the recording '{facts.get('file')}', which is no success "
                    "any more. Choose another folder with dataset=, or delete this one."
                )

    @override
    def count_part(self) -> str:
        """Leaves the number out where all recordings are taken: the dataset grows with their folder."""
        return super().count_part() if len(self._files()) > self.config.collect.num_demos else ""

    @override
    def name_part(self) -> str:
        by = "" if self.config.replay == "states" else f"-by-{self.config.replay}"
        part = "-only-corrections" if self.config.only_corrections else ""
        return f"teleop-{Path(self.config.path).name}{by}{part}"

    @override
    def identity(self) -> dict[str, Any]:
        part = {"only_corrections": True} if self.config.only_corrections else {}
        return {"source": "teleop", "replay": self.config.replay} | part

    @override
    def candidates(self) -> list[int]:
        return list(self._files())

    @override
    def arguments(self) -> dict[str, Any]:
        files = {str(episode): str(path) for episode, path in self._files().items()}
        part = self.config.only_corrections
        return super().arguments() | {"replay": self.config.replay, "files": files, "only_corrections": part}

    @override
    def outcome(self, num_kept: int, num_attempts: int) -> str:
        return f"{num_kept} of {num_attempts} recordings show a success"

    @override
    def advice_for_task(self) -> str:
        return "Recordings are replayed exactly with replay=states."

    def _files(self) -> dict[int, Path]:
        """Returns the newest success of each episode by its index, in the order of recording."""
        facts = open_recordings(Path(self.config.path)).items()
        found = {int(each["episode"]): path for path, each in facts if each["mark"] == Mark.SUCCESS}
        if not self.config.only_corrections:
            return found
        return {
            episode: path for episode, path in found.items() if Recording.read(path).taken_over is not None
        }


def _check_scene(path: Path, recorded: Mapping[str, Any], env: EnvSpec) -> None:
    """Checks that recordings are of the environment's scene.

    Raises:
        DatasetError: They are of another.
    """
    now, task, robot = scene_of(env), recorded.get("task"), recorded.get("robot", "")
    advice, by = [], ""
    if task and task != env.task:
        advice.append(what_to_give("task", task))
    if task and robot != env.robot:
        own = robot_of({**recorded, "robot": ""})
        was, wanted = robot or own, env.robot or own
        if was == wanted:  # one of them names the task's own
            now, recorded = ({**each, "robot": was} for each in (now, recorded))
        else:
            by = f" by the robot '{was}'"
            advice.append(what_to_give("robot", robot))
    if advice:
        raise DatasetError(f"path={path} holds recordings of {task}{by}: {' and '.join(advice)}.")
    check_settings(path, recorded, now, what="folder of recordings")


class TeleopEpisodes(ExpertEpisodes):
    """Replays recordings of a person.

    Args:
        replay: ``states`` or ``controls``.
        files: Episode of the train split, in words, to its recording.
        only_corrections: Begin where the person took over for the last time.
        scene: See :class:`~roboverse_learn.data.sources.expert.ExpertEpisodes`.
    """

    def __init__(
        self, *, replay: Replay, files: Mapping[str, str], only_corrections: bool = False, **scene: Any
    ) -> None:
        super().__init__(**scene)
        self._by: Replay = replay
        self._only_corrections = only_corrections
        self._files = {int(episode): Path(path) for episode, path in files.items()}
        self._replayer = Replayer(self._env)

    @override
    def attempts(self, indices: Sequence[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        recordings = [Recording.read(self._files[index]) for index in indices]
        firsts = [(each.taken_over or 0) if self._only_corrections else 0 for each in recordings]
        demonstrations = [
            _demonstration(recording, first) for recording, first in zip(recordings, firsts, strict=True)
        ]
        starts = {index: self._start_hash(index) for index in indices}
        outcomes = self._replayer.replay(demonstrations, indices, self._by)
        for recording, first, outcome in zip(recordings, firsts, outcomes, strict=True):
            if not outcome.success:
                yield outcome.episode, None
                continue
            file = self._files[outcome.episode]
            episode = self._episode(
                outcome,
                source="teleop",
                replay=self._by,
                initial_state_hash=starts[outcome.episode],
                file=file.name,
                file_sha256=file_hash(file),
                **{key: recording.facts[key] for key in _FACTS if key in recording.facts},
            )
            episode.successes = outcome.successes
            steps = np.minimum(
                first + np.arange(outcome.length), recording.length - 1
            )  # controls are held at the end
            episode.interventions = recording.interventions[steps]
            yield outcome.episode, episode

    def _start_hash(self, index: int) -> str:
        """Returns the hash of an episode as the task samples it: the expert's dataset has the same."""
        self._env.reset_envs([0], [index])
        return self._env.initial_state_hash(0)


def _demonstration(recording: Recording, first: int) -> Demonstration:
    states = State.unflatten({key: torch.from_numpy(value) for key, value in recording.states.items()})
    name = str(recording.facts["episode"])
    return Demonstration(name=name, states=states, targets=recording.actions, first_state=first)

"""Recorded episodes of a person, one file each: states in place of images, which are rendered afterwards.

A file is complete or absent, so a process that dies loses the episode that runs and no other. Marks are
changed by writing the file again. Shapes: T = control steps, A = size of the task's action.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

import numpy as np

from envs.core.atomic import remove_partial_files, write_errors
from envs.core.errors import DatasetError
from envs.spec import EnvSpec
from roboverse_learn.data.collection.schedule import check_settings
from roboverse_learn.data.dataset.damage import broken_file
from roboverse_learn.data.dataset.staging import read_header, read_tensors, write_tensors
from roboverse_learn.folder_lock import lock_directory

SUFFIX = ".teleop.safetensors"

_STATE = "state/"
_COLUMNS = ("actions", "hand_actions", "successes", "interventions")
_SCENE_KEYS = ("task", "task_kwargs", "simulator", "simulator_settings", "scenario")


class Mark(StrEnum):
    """What became of an episode: success is the task's own condition, discarded is the person's word."""

    SUCCESS = "success"
    FAILURE = "failure"
    DISCARDED = "discarded"


def scene_of(spec: EnvSpec) -> dict[str, Any]:
    """Returns what decides how episodes go on, as JSON values; their looks do not."""
    values = spec.to_json()
    robot = {"robot": spec.robot} if spec.robot else {}  # recordings of the task's own robot never named it
    return {key: values[key] for key in _SCENE_KEYS} | robot


@dataclass(frozen=True, kw_only=True, slots=True)
class Recording:
    """One episode.

    Attributes:
        states: Flattened states before each step and after the last, each (T + 1, …) float64.
        actions: Actions of the task's controller, (T, A) float32: what the environment was given.
        hand_actions: Actions of the hand, (T, 7) float32; see
            :class:`envs.hand_pose_controller.HandPoseController`. Zeros where a policy acted.
        successes: Whether the task is solved after each step, (T,) bool.
        interventions: Whether a person acted, and no policy, (T,) bool.
        facts: JSON-able: ``scene``, ``episode`` of the train split, ``instruction``, ``mark``, ``operator``,
            ``device``, and the figures of :class:`~roboverse_learn.teleoperation.quality.Quality`.
    """

    states: Mapping[str, np.ndarray]
    actions: np.ndarray
    hand_actions: np.ndarray
    successes: np.ndarray
    interventions: np.ndarray
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def length(self) -> int:
        """Control steps, T."""
        return len(self.actions)

    @property
    def mark(self) -> Mark:
        """What became of it."""
        return Mark(self.facts["mark"])

    @property
    def taken_over(self) -> int | None:
        """The step at which the person took over for the last time; None where no person acted."""
        began = np.flatnonzero(np.diff(self.interventions.astype(np.int8), prepend=np.int8(0)) == 1)
        return int(began[-1]) if len(began) else None

    def write(self, path: Path) -> None:
        """Writes the file, at once.

        Raises:
            WriteError: The disk is full, or the folder cannot be written.
        """
        arrays = {_STATE + key: value for key, value in self.states.items()}
        arrays |= {key: getattr(self, key) for key in _COLUMNS}
        write_tensors(path, arrays, dict(self.facts))

    @classmethod
    def read(cls, path: Path) -> Self:
        """Reads a file.

        Raises:
            DatasetError: It is absent, damaged, or no recording.
        """
        arrays, facts = read_tensors(path)
        states = {key.removeprefix(_STATE): value for key, value in arrays.items() if key.startswith(_STATE)}
        columns = {key: arrays[key] for key in _COLUMNS if key in arrays}
        lengths = {len(value) for value in columns.values()} | {len(value) - 1 for value in states.values()}
        if len(columns) < len(_COLUMNS) or len(lengths) != 1 or "mark" not in facts:
            raise broken_file(path, "it is no recording of teleoperation")
        return cls(states=states, **columns, facts=facts)


def read_facts(path: Path) -> dict[str, Any]:
    """Reads a recording's facts alone, which takes no memory for its states.

    Raises:
        DatasetError: The file is damaged, or no recording.
    """
    facts = read_header(path)
    if not {"mark", "episode", "scene"} <= facts.keys():
        raise broken_file(path, "it is no recording of teleoperation")
    return facts


def recordings_in(folder: Path) -> list[Path]:
    """Returns the files of a folder, in the order in which they were recorded."""
    return sorted(folder.glob(f"*{SUFFIX}"))


class RecordingFolder:
    """A folder of recordings of one scene; one process at a time writes to it.

    Args:
        root: The folder, created if absent.
        scene: From :func:`scene_of`; recordings that are there must be of the same.

    Attributes:
        facts: Facts of each recording by its file, in the order in which they were recorded.

    Raises:
        LockedError: Another process writes to the folder.
        DatasetError: It holds recordings of another scene, or a damaged one.
    """

    def __init__(self, root: Path, scene: Mapping[str, Any]) -> None:
        self.root = root
        with write_errors(root):
            root.mkdir(parents=True, exist_ok=True)
        self._lock = lock_directory(root)
        try:
            remove_partial_files(root)
            self.facts = {path: read_facts(path) for path in recordings_in(root)}
            for facts in self.facts.values():
                check_settings(root, facts["scene"], scene)
        except BaseException:
            self.close()
            raise

    def add(self, recording: Recording) -> Path:
        """Writes a recording; returns its file."""
        newest = max((int(path.name.partition(".")[0]) for path in self.facts), default=-1)
        path = self.root / f"{newest + 1:06d}{SUFFIX}"
        recording.write(path)
        self.facts[path] = dict(recording.facts)
        return path

    def remark(self, path: Path, mark: Mark) -> None:
        """Changes the mark of a recording."""
        recording = Recording.read(path)
        recording = replace(recording, facts={**recording.facts, "mark": str(mark)})
        recording.write(path)
        self.facts[path] = dict(recording.facts)

    def count(self, mark: Mark) -> int:
        """Returns how many recordings have a mark."""
        return sum(facts["mark"] == mark for facts in self.facts.values())

    def solved_episodes(self) -> set[int]:
        """Returns the episodes of the train split of which there is a success."""
        return {int(facts["episode"]) for facts in self.facts.values() if facts["mark"] == Mark.SUCCESS}

    def close(self) -> None:
        """Releases the folder; calling it twice is harmless."""
        self._lock.release()


def open_recordings(folder: Path) -> dict[Path, dict[str, Any]]:
    """Returns the facts of each recording of a folder, without locking it.

    Raises:
        DatasetError: There is no recording, or one is damaged.
    """
    files = recordings_in(folder)
    if not files:
        raise DatasetError(_no_recordings(folder))
    return {path: read_facts(path) for path in files}


def _no_recordings(folder: Path) -> str:
    """Returns the message for a path that is no folder of recordings."""
    inside = [path for path in sorted(folder.glob("*")) if path.is_dir()]
    meant = [folder.parent] if folder.is_file() else inside
    found = next((path for path in meant if recordings_in(path)), None)
    if folder.is_file():
        what = f"this is a file, and needed is the folder that holds the recordings (*{SUFFIX})"
    elif folder.exists():
        what = f"there is no recording of teleoperation (*{SUFFIX})"
    else:
        what = "there is no such folder"
    near = f" Did you mean path={found}?" if found else ""
    return f"path={folder}: {what}.{near} Make some with: roboverse teleoperate task=<name>"

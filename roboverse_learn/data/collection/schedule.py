"""Schedules pool episodes and commits finished ones in a deterministic order."""

import itertools
import json
import shutil
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmark.statistics import wilson
from envs.core.atomic import write_json
from envs.core.errors import DatasetError
from roboverse_learn.data.dataset.damage import broken_file, read_json
from roboverse_learn.data.dataset.schema import COLLECTION_PATH
from roboverse_learn.data.dataset.staging import STAGING_DIRECTORY, load_staged, staged_directory
from roboverse_learn.data.dataset.writer import DatasetWriter

GIVE_UP_AFTER = 100
"""Failures of a run before it may end without hope: a demonstrator of 3 % gets so far one time in twenty."""

_CONFIDENCE = 0.999
"""Confidence that all candidates are too few; tested again after every failure."""


class TooFewSuccessesError(DatasetError):
    """The candidates give too few successes."""


class Schedule:
    """The candidates of a collection and what became of them.

    A candidate is handed out only while the candidates before it cannot give enough successes, and
    commits follow the candidates' order; so which episodes are tried and kept does not depend on how
    many workers there are or how fast they are.

    Args:
        writer: The open dataset.
        candidates: Pool indices in the order of preference.
        target: Successful episodes wanted in the dataset.
        settings: JSON-able; what a resumed collection must have in common with the first run.
        fewer_ok: When every candidate was tried, any number of successes but none is enough.
        give_up_after: Failures of this run before it may end because no episode succeeds, or so few that all
            candidates together will not be enough.

    Raises:
        DatasetError: The dataset was started with other settings, or has episodes of no collection.
    """

    def __init__(
        self,
        writer: DatasetWriter,
        candidates: Sequence[int],
        target: int,
        settings: Mapping[str, Any],
        *,
        fewer_ok: bool = False,
        give_up_after: int = GIVE_UP_AFTER,
    ) -> None:
        self._writer = writer
        self._target, self._fewer_ok = target, fewer_ok
        self._failures_left = give_up_after
        self._candidates = [int(index) for index in candidates]
        self._path = writer.root / COLLECTION_PATH
        self._settings = json.loads(json.dumps(settings, sort_keys=True))
        self._failed = self._read_record()
        self._committed = {json.loads(key)["episode"] for key in writer.episode_keys}
        self._staged = self._find_staged()
        self._outstanding: set[int] = set()
        self._next = 0
        # Candidates before `_next` that are, or may become, successes.
        self._hopeful = len(self._committed - set(self._candidates))
        self._commit_position = 0
        self._write_record()
        self._commit_ready()

    @property
    def num_successes(self) -> int:
        """Successful episodes on disk, committed or waiting for an earlier candidate."""
        return len(self._committed) + len(self._staged)

    @property
    def num_failures(self) -> int:
        """Candidates that the expert failed, in all runs."""
        return len(self._failed)

    @property
    def finished(self) -> bool:
        """Whether the dataset holds all the episodes wanted, or all that there are where those will do."""
        enough = self._fewer_ok and self._exhausted and bool(self._committed)
        return len(self._committed) >= self._target or enough

    @property
    def _exhausted(self) -> bool:
        """Whether every candidate was tried, and the successes are too few."""
        tried = self._next >= len(self._candidates) and not self._outstanding
        return tried and self._hopeful < self._target

    def next_batch(self, size: int) -> list[int]:
        """Hands out at most ``size`` candidates; see :meth:`next_index`."""
        return list(itertools.islice(iter(self.next_index, None), size))

    def next_index(self) -> int | None:
        """Hands out a candidate, or None while those in flight may be enough.

        Raises:
            TooFewSuccessesError: Every candidate was tried, and the successes are too few.
        """
        while self._hopeful < self._target and self._next < len(self._candidates):
            index = self._candidates[self._next]
            self._next += 1
            if index in self._failed:
                continue
            self._hopeful += 1
            if index not in self._committed and index not in self._staged:
                self._outstanding.add(index)
                return index
        if self._exhausted and not self.finished:
            message = (
                f"The {len(self._candidates)} candidate episodes gave {self.num_successes} successes; "
                f"{self._target} are needed."
            )
            raise TooFewSuccessesError(f"{message}{self._what_there_is()}")
        return None

    def resolve(self, *ended: tuple[int, Path | None]) -> None:
        """Records how candidates ended, and commits what is ready, together.

        Args:
            *ended: Pool indices that :meth:`next_index` gave, each with its staged episode, or None if it
                failed.

        Raises:
            TooFewSuccessesError: Many candidates failed, and the others will not be enough.
            DatasetError: An index is not in flight, or the disk is full.
        """
        try:
            for index, directory in ended:
                self._settle(index, directory)
        finally:
            self._commit_ready()

    def _settle(self, index: int, directory: Path | None) -> None:
        if index not in self._outstanding:
            raise DatasetError(f"The source yielded pool episode {index}, which was not requested.")
        self._outstanding.discard(index)
        if directory is not None:
            self._staged[index] = directory
            return
        self._failed.add(index)
        self._hopeful -= 1
        self._write_record()
        self._failures_left -= 1
        if self._failures_left <= 0:
            self._refuse_to_hope()

    def _refuse_to_hope(self) -> None:
        """Ends a collection in which nothing succeeds, or too little for all candidates to be enough."""
        done, tried = self.num_successes, self.num_successes + self.num_failures
        if not done:
            raise TooFewSuccessesError(
                f"None of the {tried} episodes that were tried succeeded. The same command tries others."
            )
        rate = wilson(done, tried, _CONFIDENCE)[1]
        if not self._fewer_ok and done + rate * (len(self._candidates) - tried) < self._target:
            raise TooFewSuccessesError(
                f"{done} of the {tried} episodes that were tried succeeded ({done / tried:.1%}). All "
                f"{len(self._candidates)} will not give the {self._target} successes that are needed."
                f"{self._what_there_is()}"
            )

    def _what_there_is(self) -> str:
        """Says how to take the successes as they are."""
        done = self.num_successes
        return f" num_demos={done} dataset={self._writer.root} takes those that there are." * (done > 0)

    def _commit_ready(self) -> None:
        """Commits staged episodes as long as every candidate before them is settled."""
        ready: list[int] = []
        while self._commit_position < len(self._candidates):
            index = self._candidates[self._commit_position]
            if index in self._staged:
                if len(self._committed) + len(ready) >= self._target:
                    break
                ready.append(index)
            elif index not in self._failed and index not in self._committed:
                break
            self._commit_position += 1
        if ready:
            self._writer.commit(*(load_staged(self._staged.pop(index)) for index in ready))
            self._committed.update(ready)

    def _find_staged(self) -> dict[int, Path]:
        """Finds the episodes that an earlier run finished and did not commit."""
        staged, folder = {}, self._writer.root / STAGING_DIRECTORY
        present = set(folder.iterdir()) if folder.is_dir() else set()
        for index in self._candidates if present else ():
            directory = staged_directory(self._writer.root, index)
            if directory not in present:
                continue
            try:
                if index in self._committed:
                    raise DatasetError("It was committed just before the kill.")
                load_staged(directory)
                staged[index] = directory
            except DatasetError:
                shutil.rmtree(directory, ignore_errors=True)
        return staged

    def _read_record(self) -> set[int]:
        """Reads which candidates failed in earlier runs, and checks that the settings are theirs."""
        root = self._writer.root
        if not self._path.exists():
            if self._writer.num_episodes:
                raise DatasetError(
                    f"The dataset '{root}' holds episodes that were not collected there. Choose another "
                    f"folder, or train on it as it is: roboverse train dataset={root}."
                )
            return set()
        before, failed = read_record(root)
        if before != self._settings and self._writer.is_empty:
            return set()  # nothing but failures of other settings
        check_settings(root, before, self._settings)
        return failed

    def _write_record(self) -> None:
        write_json(self._path, {"settings": self._settings, "failed": sorted(self._failed)})


def read_record(root: Path) -> tuple[dict[str, Any], set[int]]:
    """Returns the settings of a collection, and the candidates that failed.

    Raises:
        DatasetError: The record is absent or damaged.
    """
    record = read_json(root / COLLECTION_PATH)
    if not (
        isinstance(record, dict)
        and isinstance(record.get("settings"), dict)
        and isinstance(record.get("failed"), list)
    ):
        raise broken_file(root / COLLECTION_PATH, "it holds no settings, or no list of failed episodes")
    return record["settings"], set(record["failed"])


def check_settings(
    root: Path,
    before: Mapping[str, Any],
    now: Mapping[str, Any],
    keys: Collection[str] | None = None,
    advice: str = "Use the same settings, or choose another folder.",
    what: str = "dataset",
) -> None:
    """Checks that a dataset was collected with the settings that are given.

    Args:
        root: The dataset's folder.
        before: Its settings.
        now: Those that are given.
        keys: Which of them must be the same; all by default.
        advice: What to do where some differ.
        what: What the folder is, for the message.

    Raises:
        DatasetError: Some differ.
    """
    now = json.loads(json.dumps(now))
    compared = {*before, *now} if keys is None else keys
    other = sorted(key for key in compared if before.get(key) != now.get(key))
    if other:
        raise DatasetError(
            f"The {what} '{root}' was begun with {_words(before, other)}; now given: {_words(now, other)}. "
            f"{advice}"
        )


def _words(settings: Mapping[str, Any], keys: Sequence[str]) -> str:
    """Returns chosen settings as words for a message."""
    return ", ".join(f"{key}={settings.get(key)!r}" for key in keys)

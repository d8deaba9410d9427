"""Verdicts on demonstrations: whether they can be read, and pass our checker by states and by controls."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from envs.core.atomic import write_json
from envs.core.errors import ConfigError, DatasetError, SimulatorError
from envs.core.fingerprint import file_hash
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.data.dataset.damage import read_json
from roboverse_learn.data.importers.demonstration import Demonstration, DemonstrationFile
from roboverse_learn.data.importers.replayer import Replay, Replayer

IMPORT_PATH = "meta/import.json"
"""File of a dataset of imported demonstrations with the verdict on each of them."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """Verdict on one demonstration.

    Attributes:
        file: Its file, relative to the folder that was given.
        name: Its name in the file; empty where the whole file cannot be read.
        episode: The episode of the train split that it takes its looks from.
        states: Whether it passes by states; None where there are none.
        controls: Whether it passes by controls.
        file_success: What the file says; None where it says nothing.
        error: Why it was skipped; empty where it was not.
    """

    file: str
    name: str
    episode: int = -1
    states: bool | None = None
    controls: bool | None = None
    file_success: bool | None = None
    error: str = ""

    def passes(self, replay: Replay) -> bool:
        """Whether it belongs in a dataset of that replay."""
        return getattr(self, replay) is True


@dataclass(frozen=True, kw_only=True, slots=True)
class ImportSummary:
    """Verdicts on all demonstrations.

    Attributes:
        source: Format.
        replay: The replay that the dataset is of.
        files: File, relative to the folder that was given, to the SHA-256 of its content.
        conditions: JSON-able: what else the verdicts depend on, such as the task and the simulator.
        verdicts: One per demonstration, and one per file that cannot be read.
    """

    source: str
    replay: Replay
    files: Mapping[str, str]
    conditions: Mapping[str, Any]
    verdicts: tuple[Verdict, ...]

    @property
    def read(self) -> tuple[Verdict, ...]:
        """The demonstrations that could be replayed."""
        return tuple(verdict for verdict in self.verdicts if not verdict.error)

    @property
    def skipped(self) -> tuple[Verdict, ...]:
        """The others."""
        return tuple(verdict for verdict in self.verdicts if verdict.error)

    def count(self, replay: Replay) -> int:
        """Number that pass a replay."""
        return sum(verdict.passes(replay) for verdict in self.read)

    @property
    def num_said(self) -> int:
        """Number whose success both their file and a replay by states state."""
        return sum(None not in (v.file_success, v.states) for v in self.read)

    @property
    def num_agreeing(self) -> int:
        """In how many of those the two agree."""
        return sum(v.file_success is not None and v.file_success == v.states for v in self.read)

    @property
    def num_with_states(self) -> int:
        """Number that can be replayed by states."""
        return sum(verdict.states is not None for verdict in self.read)

    def identity(self) -> dict[str, Any]:
        """Returns what a dataset that is continued must have in common with its beginning."""
        return {"source": self.source, "replay": self.replay, "files": dict(self.files)}

    def chosen(self) -> list[Verdict]:
        """Returns the demonstrations that the dataset is made of.

        Raises:
            ConfigError: Replay by states was requested, and no demonstration has states.
            DatasetError: None passes.
        """
        passing = [verdict for verdict in self.read if verdict.passes(self.replay)]
        if passing:
            return passing
        if self.replay == "states" and not self.num_with_states:
            raise ConfigError("These demonstrations have no recorded states. Give replay=controls.")
        reason = f" {len(self.skipped)} were skipped: {self.skipped[0].error}" if self.skipped else ""
        raise DatasetError(
            f"None of the {len(self.read)} demonstrations passes by {self.replay} (by states "
            f"{self.count('states')}, by controls {self.count('controls')}).{reason}"
        )

    def to_json(self) -> dict[str, Any]:
        """Returns everything as JSON values."""
        return {
            **self.identity(),
            "conditions": dict(self.conditions),
            "num_read": len(self.read),
            "num_passing": {"states": self.count("states"), "controls": self.count("controls")},
            "episodes": [asdict(verdict) for verdict in self.verdicts],
        }


def find_files(file_type: type[DemonstrationFile], path: Path) -> list[Path]:
    """Returns the files of a format: ``path`` itself, or those in the folder that it is.

    Raises:
        DatasetError: There is no such file.
    """
    source, suffixes = file_type.format, file_type.suffixes
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise DatasetError(f"path={path} does not exist. Give a file of {source}, or a folder of them.")
    files = sorted(file for file in path.rglob("*") if file.is_file() and file.name.endswith(suffixes))
    if not files:
        raise DatasetError(f"The folder '{path}' holds no file of {source} ({', '.join(suffixes)}).")
    return files


def judge(
    *,
    file_type: type[DemonstrationFile],
    path: Path,
    env: RoboVerseVectorEnv,
    replay: Replay,
    conditions: Mapping[str, Any],
    on_progress: Callable[[int, int], None] | None = None,
) -> ImportSummary:
    """Replays every demonstration both ways, without rendering.

    Args:
        file_type: Reads the format.
        path: A file, or a folder of files.
        env: The env to replay in, of the train split.
        replay: The replay that a dataset is wanted of.
        conditions: JSON-able: task, options and simulator of the env.
        on_progress: Called with the numbers of demonstrations done, and of all that are known of.

    Raises:
        DatasetError: No demonstration can be read, or there are more than episodes in the split.
    """
    files = find_files(file_type, path)
    replayer, episodes = Replayer(env), iter(env.split_indices.tolist())
    verdicts: list[Verdict] = []
    for file in files:
        relative = _relative(file, path)
        try:
            opened = file_type(file, env.task)
        except DatasetError as error:
            if len(files) == 1:
                raise
            verdicts.append(Verdict(file=relative, name="", error=str(error)))
            continue
        known = len(verdicts) + len(opened.names)
        try:
            for batch in _batches(opened.names, env.num_envs):
                verdicts += _judge_batch(opened, relative, batch, episodes, replayer)
                if on_progress is not None:
                    on_progress(len(verdicts), known)
        finally:
            opened.close()
    summary = ImportSummary(
        source=file_type.format,
        replay=replay,
        files=_hashes(files, path),
        conditions=conditions,
        verdicts=tuple(verdicts),
    )
    if not summary.read:
        first = verdicts[0].error if verdicts else "there is none"
        raise DatasetError(f"No demonstration in '{path}' can be used: {first}")
    return summary


def _judge_batch(
    opened: DemonstrationFile,
    file: str,
    names: Sequence[str],
    episodes: Iterator[int],
    replayer: Replayer,
) -> list[Verdict]:
    """Reads and replays a few demonstrations; a damaged one spoils none of the others."""
    verdicts: dict[str, Verdict] = {}
    whole: list[tuple[Verdict, Demonstration]] = []
    for name in names:
        episode = next(episodes, None)
        if episode is None:
            raise DatasetError(f"'{file}' holds more demonstrations than the train split has episodes.")
        verdict = Verdict(file=file, name=name, episode=episode)
        try:
            demonstration = opened.read(name)
        except DatasetError as error:
            verdicts[name] = _with(verdict, error=str(error))
        else:
            whole.append((_with(verdict, file_success=demonstration.succeeded), demonstration))
    for verdict, states, controls in _replay_both(replayer, whole):
        done = {"error": controls} if isinstance(controls, str) else {"states": states, "controls": controls}
        verdicts[verdict.name] = _with(verdict, **done)
    return [verdicts[name] for name in names]


def _replay_both(
    replayer: Replayer, whole: Sequence[tuple[Verdict, Demonstration]]
) -> Iterator[tuple[Verdict, bool | None, bool | str]]:
    """Yields what each demonstration gives by states and by controls, or why it gives nothing."""
    try:
        outcomes = list(_outcomes(replayer, whole))
    except SimulatorError as error:
        if len(whole) == 1:
            yield whole[0][0], None, str(error)
        else:  # find the one that breaks the simulation
            for one in whole:
                yield from _replay_both(replayer, [one])
        return
    yield from outcomes


def _outcomes(
    replayer: Replayer, whole: Sequence[tuple[Verdict, Demonstration]]
) -> Iterator[tuple[Verdict, bool | None, bool | str]]:
    recorded = [(v, d) for v, d in whole if d.has_states]
    by_states = replayer.passes([d for _, d in recorded], [v.episode for v, _ in recorded], "states")
    states = {v.name: passed for (v, _), passed in zip(recorded, by_states, strict=True)}
    by_controls = replayer.passes([d for _, d in whole], [v.episode for v, _ in whole], "controls")
    for (verdict, _), controls in zip(whole, by_controls, strict=True):
        yield verdict, states.get(verdict.name), controls


def _with(verdict: Verdict, **values: Any) -> Verdict:
    return Verdict(**(asdict(verdict) | values))


def _batches(names: Sequence[str], size: int) -> Iterator[Sequence[str]]:
    for first in range(0, len(names), size):
        yield names[first : first + size]


def _relative(file: Path, path: Path) -> str:
    return file.relative_to(path if path.is_dir() else path.parent).as_posix()


def _hashes(files: Sequence[Path], path: Path) -> dict[str, str]:
    """Returns the SHA-256 of each file's content."""
    return {_relative(file, path): file_hash(file) for file in files}


def known_summary(
    root: Path,
    *,
    file_type: type[DemonstrationFile],
    path: Path,
    replay: Replay,
    conditions: Mapping[str, Any],
) -> ImportSummary | None:
    """Returns what :func:`judge` found when the dataset was made, or None where that does not hold now.

    Args:
        root: Folder of the dataset.
        file_type: Reads the format.
        path: A file, or a folder of files.
        replay: The replay that a dataset is wanted of.
        conditions: As given to :func:`judge`.
    """
    if not (root / IMPORT_PATH).exists():
        return None
    saved = read_json(root / IMPORT_PATH)
    files = _hashes(find_files(file_type, path), path)
    source = file_type.format
    same = (source, files, json.loads(json.dumps(conditions)))
    if (saved.get("source"), saved.get("files"), saved.get("conditions")) != same:
        return None
    verdicts = tuple(Verdict(**verdict) for verdict in saved["episodes"])
    return ImportSummary(source=source, replay=replay, files=files, conditions=conditions, verdicts=verdicts)


def write_summary(root: Path, summary: ImportSummary) -> None:
    """Writes what became of each demonstration into its dataset."""
    write_json(root / IMPORT_PATH, summary.to_json())

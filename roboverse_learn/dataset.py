"""``roboverse dataset info``, ``roboverse dataset merge`` and ``roboverse dataset get``."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from envs.core.arguments import parse
from envs.core.errors import ConfigError, unknown_name
from roboverse_learn.config.path_keys import check_path

if TYPE_CHECKING:
    from roboverse_learn.data import DatasetInfo

ACTIONS = ("merge", "info", "get")


@dataclass(frozen=True, kw_only=True)
class MergeConfig:
    """Appends every episode of several datasets that another does not hold yet; videos are not encoded again.

    Attributes:
        from_: Folders of datasets of the same robot, cameras and image size; typed as ``from=[a,b]``.
        out: Folder of the merged dataset; it may exist.
    """

    from_: tuple[str, ...] = ()
    out: str = ""


@dataclass(frozen=True, kw_only=True)
class InfoConfig:
    """Says what a dataset holds, and which of its videos are damaged.

    Attributes:
        dataset: Folder of the dataset.
    """

    dataset: str = ""


@dataclass(frozen=True, kw_only=True)
class GetConfig:
    """Downloads a LeRobotDataset of the Hugging Face hub; a download that was interrupted continues.

    Attributes:
        from_: Name on the hub, owner/name; typed as ``from=owner/name``.
        out: Folder that it goes to; empty for datasets/owner/name.
        revision: Branch, tag or commit; empty for that of LeRobot's present format.
    """

    from_: str = ""
    out: str = ""
    revision: str = ""


@dataclass(frozen=True, slots=True)
class DatasetReport:
    """What a dataset holds.

    Attributes:
        text: What to print.
        ok: Whether each of its videos has all of its frames.
    """

    text: str
    ok: bool = True

    def __str__(self) -> str:
        return self.text


def dataset(words: Sequence[str]) -> DatasetReport:
    """Runs one action on datasets; returns what to print.

    Raises:
        ConfigError: A key is missing, or the hub does not give a dataset.
        DatasetError: A dataset is absent, damaged in another file than a video, or does not fit the others.
    """
    from roboverse_learn.data import DatasetInfo, merge
    from roboverse_learn.hub.download import get_dataset

    action, *rest = words or [""]
    note = ""
    if action not in ACTIONS:
        raise unknown_name("action on datasets", action, ACTIONS, "As in: roboverse dataset merge --help")
    for key, given, value in (word.partition("=") for word in rest):
        if given:
            check_path(key, key, value)
    if action == "merge":
        merged = parse("roboverse dataset merge", MergeConfig, rest)
        if not merged.from_ or not merged.out:
            raise ConfigError("dataset merge needs from=[<folder>,<folder>] and out=<folder>.")
        given = sum(map(_num_episodes, merged.from_))  # before: out= may be one of them
        before = _num_episodes(merged.out)
        info = merge(merged.from_, merged.out)
        note = _added(given, before, info.num_episodes)
    elif action == "get":
        wanted = parse("roboverse dataset get", GetConfig, rest)
        folder = Path(wanted.out or f"datasets/{wanted.from_}")
        info = DatasetInfo.open(get_dataset(wanted.from_, folder, wanted.revision))
    else:
        rest = [f"dataset={word}" if _is_folder(word) else word for word in rest]
        folder = parse("roboverse dataset info", InfoConfig, rest).dataset
        if not folder:
            raise ConfigError("dataset info needs dataset=<folder>.")
        info = DatasetInfo.open(folder)
    return _report(info, note)


def _report(info: "DatasetInfo", note: str) -> DatasetReport:
    """Describes a dataset; one whose videos are damaged has no hash."""
    from roboverse_learn.commands.dataset_contents import contents
    from roboverse_learn.data import dataset_hash
    from roboverse_learn.data.dataset.images import damaged_videos

    damaged = damaged_videos(info)
    lines = [
        f"{info.root}: {info.num_episodes} episodes, {info.num_frames} frames at {info.fps} Hz, "
        + (_count(damaged) if damaged else f"hash {dataset_hash(info.root)[:16]}"),
        *contents(info),
        *([note] if note else []),
        *(f"damaged: {error}" for error in damaged),
    ]
    return DatasetReport("\n".join(lines), ok=not damaged)


def _count(damaged: Sequence[Exception]) -> str:
    return f"{len(damaged)} of its videos {'are' if len(damaged) > 1 else 'is'} damaged"


def _is_folder(word: str) -> bool:
    """Whether a word is a folder rather than a key: a dataset's name may have options, as in ``level=3``."""
    return Path(word).is_dir() or not ("=" in word or word.startswith("-"))


def _num_episodes(folder: str) -> int:
    """Returns how many episodes a folder holds; 0 if there is no dataset."""
    from roboverse_learn.data.dataset.info import read_info
    from roboverse_learn.data.dataset.schema import INFO_PATH

    return int(read_info(Path(folder))["total_episodes"]) if (Path(folder) / INFO_PATH).exists() else 0


def _added(given: int, before: int, after: int) -> str:
    """Says how many episodes were appended to a dataset, and how many it had; empty for a new one of all."""
    added = after - before
    notes = [f"added: {added} episodes to the {before} that were there"] if before else []
    if added < given:
        again = f"{given - added} of the {given} episodes given"
        notes.append(f"left out: {again}, which are there already: each is kept once")
    return "\n".join(notes)

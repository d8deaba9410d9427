"""Several datasets as one, for a policy that learns their tasks together by their instructions.

States and actions that are shorter than the longest are padded with zeros. Statistics weigh each task alike,
also where training samples them unequally often (``train.mixing``).

Shape legend: N = frames, B = batch, T = time steps of a window, D = entries of a vector.
"""

import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from envs.core.errors import DatasetError
from envs.core.machine import num_cores
from policies.learned_tasks import TASK_INDEX, Instructions, LearnedTask
from roboverse_learn.data.dataset.decoders import Decoders
from roboverse_learn.data.dataset.frame_table import FrameTable
from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.data.dataset.reader import ResidentDataset
from roboverse_learn.data.dataset.schema import ACTION_KEY, STATE_KEY, Feature, video_keys
from roboverse_learn.data.dataset.stats import QUANTILES, FeatureStats, Stats, column_stats

if TYPE_CHECKING:
    import torch

_LOG = logging.getLogger(__name__)
_PADDED = (STATE_KEY, ACTION_KEY)

SECONDS_A_MESSAGE = 15.0
"""Between messages on the datasets that are decoded."""


@dataclass(frozen=True)
class _Group:
    """The episodes of one task in one dataset.

    Attributes:
        part: Which dataset.
        name: The task.
        episodes: Episodes of the dataset, counted in it.
    """

    part: int
    name: str
    episodes: np.ndarray


class Mixture:
    """The frames of one dataset or of several, with the interface of :class:`ResidentDataset`.

    A frame's ``task_index`` counts the instructions of all datasets, one dataset after the other.

    Args:
        parts: The datasets, with the same cameras and image size.
        names: Task of each dataset, where its episodes do not name theirs.

    Attributes:
        info: Metadata of all frames together: largest vectors, statistics of balanced tasks.
        instructions: The instructions and tasks.
        groups: Episodes of each task, of which every batch has frames.

    Raises:
        DatasetError: The datasets differ in their cameras or image size.
    """

    def __init__(self, parts: Sequence[ResidentDataset], names: Sequence[str]) -> None:
        infos = [part.info for part in parts]
        _check_cameras(infos)
        starts = np.cumsum([0, *(info.num_frames for info in infos)])
        first_episode = np.cumsum([0, *(info.num_episodes for info in infos)])
        groups = [group for k, info in enumerate(infos) for group in _groups(info, k, names[k])]
        tasks = sorted({group.name for group in groups}, key=[group.name for group in groups].index)
        self.groups = [
            np.concatenate([g.episodes + first_episode[g.part] for g in groups if g.name == name])
            for name in tasks
        ]
        sizes = {key: max(info.shapes[key][0] for info in infos) for key in _PADDED}
        self.info = _joined_info(infos, starts, groups, sizes)
        self.instructions = _instructions(infos, groups, tasks)
        self._table = FrameTable(
            _joined_columns(parts, sizes),
            {key: [part.frames[key] for part in parts] for key in infos[0].camera_keys},
            starts=np.repeat(self.info.episode_starts, self.info.episode_lengths),
            ends=np.repeat(self.info.episode_ends, self.info.episode_lengths),
            firsts=starts,
            device=parts[0].device,
        )

    @classmethod
    def open(cls, folders: Mapping[str, str | Path], device: "str | torch.device") -> "Mixture":
        """Reads the datasets of tasks.

        Args:
            folders: Folder of the dataset of each task.
            device: Where batches are wanted; see :class:`ResidentDataset`.
        """
        infos = [DatasetInfo.open(root) for root in folders.values()]
        num_images = sum(info.num_frames * len(video_keys(info.features)) for info in infos)
        parts, said = [], time.monotonic()
        with Decoders(num_images, num_cores()) as decoders:
            for info in infos:
                parts.append(ResidentDataset(info, device=device, decoders=decoders))
                if time.monotonic() - said >= SECONDS_A_MESSAGE:
                    said = time.monotonic()
                    _LOG.info("%d of %d datasets are decoded.", len(parts), len(infos))
        return cls(parts, list(folders))

    def __len__(self) -> int:
        """Number of frames."""
        return self.info.num_frames

    def sample(
        self,
        indices: "np.ndarray | Sequence[int]",
        delta_indices: Mapping[str, Sequence[int]] | None = None,
        *,
        keys: Sequence[str],
    ) -> "dict[str, torch.Tensor]":
        """Gathers a batch; see :meth:`ResidentDataset.sample`."""
        return self._table.sample(indices, delta_indices, keys=keys)


def mixed_features(all_features: Sequence[Mapping[str, Feature]]) -> dict[str, Feature]:
    """Returns the features of datasets together: of vectors the longest, without names where they differ."""
    features: dict[str, Feature] = {key: dict(value) for key, value in all_features[0].items()}  # type: ignore[misc]
    for key in _PADDED:
        each = [features[key] for features in all_features if key in features]
        if each:
            features[key] = max(each, key=lambda feature: feature["shape"][0])
    return features


def frames_of_tasks(info: DatasetInfo, name: str) -> dict[str, int]:
    """Returns the frames of each task that the episodes of a dataset name, else all as of task ``name``."""
    return {group.name: int(info.episode_lengths[group.episodes].sum()) for group in _groups(info, 0, name)}


def _joined_columns(parts: Sequence[ResidentDataset], sizes: Mapping[str, int]) -> "dict[str, torch.Tensor]":
    """Returns the numbers that all frames have, padded to one size.

    Instructions are counted over all datasets.
    """
    import torch

    first_text = np.cumsum([0, *(len(part.info.tasks) for part in parts)]).tolist()
    columns: dict[str, torch.Tensor] = {}
    for key in parts[0].frames:
        if key in parts[0].info.camera_keys or any(key not in part.frames for part in parts):
            continue
        each = [part.frames[key] for part in parts]
        if key in sizes:
            each = [torch.nn.functional.pad(x, (0, sizes[key] - x.shape[-1])) for x in each]
        elif key == TASK_INDEX:
            each = [x + first for x, first in zip(each, first_text, strict=False)]
        if len({x.shape[1:] for x in each}) == 1:
            columns[key] = torch.cat(each)
    return columns


def _groups(info: DatasetInfo, part: int, name: str) -> Iterator[_Group]:
    """Yields the episodes of each task that the episodes of a dataset name, else all as of one."""
    named = [str(each.get("task", name)) for each in info.episode_metadata]
    for task in dict.fromkeys(named):
        yield _Group(part, task, np.flatnonzero(np.array([each == task for each in named])))


def _instructions(infos: Sequence[DatasetInfo], groups: Sequence[_Group], tasks: list[str]) -> Instructions:
    """Returns the instructions of datasets, each of the task of the first episode that has it."""
    texts: list[str] = []
    task_of: list[int] = []
    for k, info in enumerate(infos):
        own = {
            text: group.name
            for group in reversed([group for group in groups if group.part == k])
            for episode in group.episodes.tolist()
            for text in info.episodes[episode]["tasks"]
        }
        first = next(group.name for group in groups if group.part == k)
        texts += info.tasks
        task_of += [tasks.index(own.get(text, first)) for text in info.tasks]
    of_tasks = {group.name: infos[group.part] for group in groups}
    learned = tuple(_learned_task(name, of_tasks[name]) for name in tasks)
    return Instructions(texts=tuple(texts), tasks=learned, task_of=tuple(task_of))


def _learned_task(name: str, info: DatasetInfo) -> LearnedTask:
    (state,), (action,) = (info.shapes[key] for key in _PADDED)
    names = [info.features[key].get("names") for key in _PADDED]
    state_names, action_names = (tuple(map(str, each)) if isinstance(each, list) else () for each in names)
    return LearnedTask(
        name=name,
        state_size=state,
        action_size=action,
        state_names=state_names,
        action_names=action_names,
    )


def _joined_info(
    infos: Sequence[DatasetInfo], starts: np.ndarray, groups: Sequence[_Group], sizes: Mapping[str, int]
) -> DatasetInfo:
    """Returns the metadata of datasets one after the other."""
    episodes: list[dict[str, Any]] = []
    for info, start in zip(infos, starts, strict=False):
        for episode in info.episodes:
            bounds = {key: episode[key] + int(start) for key in ("dataset_from_index", "dataset_to_index")}
            episodes.append(episode | bounds)
    return replace(
        infos[0],
        features=mixed_features([info.features for info in infos]),
        num_episodes=len(episodes),
        num_frames=sum(info.num_frames for info in infos),
        stats=_balanced_stats(infos, groups, sizes),
        tasks=tuple(text for info in infos for text in info.tasks),
        episodes=tuple(episodes),
    )


def _balanced_stats(
    infos: Sequence[DatasetInfo], groups: Sequence[_Group], sizes: Mapping[str, int]
) -> Stats:
    """Returns statistics of vectors and images in which each task weighs alike.

    Those of an entry of a vector are over the tasks that have it. Several tasks of one dataset have their own
    statistics of vectors, and share those of its images. Quantiles do not combine: one dataset keeps its
    own, which are of all its frames, and those of several datasets are computed from their vectors.
    """
    of_groups: list[Stats] = []
    for group in groups:
        info = infos[group.part]
        alone = len([each for each in groups if each.part == group.part]) == 1
        own = info.stats if alone else info.stats | _column_stats(info, group.episodes)
        of_groups.append({key: own[key] for key in (*_PADDED, *info.camera_keys) if key in own})
    joined: Stats = {}
    for key in of_groups[0]:
        each = [of_group[key] for of_group in of_groups if key in of_group]
        if key not in _PADDED:
            joined[key] = _equal_mean(each)
            continue
        entries = [
            _equal_mean([_entry(stats, entry) for stats in each if entry < len(stats["mean"])])
            for entry in range(sizes[key])
        ]
        joined[key] = {name: np.concatenate([entry[name] for entry in entries]) for name in entries[0]}
    if len(infos) == 1:
        return {key: {**own, **joined.get(key, {})} for key, own in infos[0].stats.items()}
    for key in _PADDED:
        joined[key] |= _balanced_quantiles(infos, groups, key, sizes[key])
    return joined


def _balanced_quantiles(
    infos: Sequence[DatasetInfo], groups: Sequence[_Group], key: str, size: int
) -> FeatureStats:
    """Returns quantiles of each entry over the frames of the tasks that have it, each task weighing alike."""
    columns = [info.read_columns([key])[key] for info in infos]
    of_groups = [columns[group.part][_rows(infos[group.part], group.episodes)] for group in groups]
    quantiles = np.empty((len(QUANTILES), size))
    for entry in range(size):
        own = [rows[:, entry] for rows in of_groups if entry < rows.shape[1]]
        weights = np.concatenate([np.full(len(values), 1.0 / len(values)) for values in own])
        quantiles[:, entry] = np.quantile(
            np.concatenate(own), list(QUANTILES.values()), weights=weights, method="inverted_cdf"
        )
    return dict(zip(QUANTILES, quantiles, strict=True))


def _column_stats(info: DatasetInfo, episodes: np.ndarray) -> Stats:
    columns = info.read_columns([key for key in _PADDED if key in info.features])
    rows = _rows(info, episodes)
    return column_stats({key: values[rows] for key, values in columns.items()})


def _rows(info: DatasetInfo, episodes: np.ndarray) -> np.ndarray:
    """Returns the frames of some episodes of a dataset."""
    return np.concatenate(
        [np.arange(info.episode_starts[e], info.episode_ends[e]) for e in episodes.tolist()]
    )


def _entry(stats: FeatureStats, entry: int) -> FeatureStats:
    return {name: stats[name][entry : entry + 1] for name in ("mean", "std", "min", "max")}


def _equal_mean(each: Sequence[FeatureStats]) -> FeatureStats:
    """Combines statistics as if each were of as many frames: mean of means, variance within and between."""
    mean = np.mean([stats["mean"] for stats in each], 0)
    square = np.mean([stats["std"] ** 2 + stats["mean"] ** 2 for stats in each], 0)
    return {
        "mean": mean,
        "std": np.sqrt(np.maximum(square - mean**2, 0.0)),
        "min": np.min([stats["min"] for stats in each], 0),
        "max": np.max([stats["max"] for stats in each], 0),
    }


def _check_cameras(infos: Sequence[DatasetInfo]) -> None:
    """Checks that datasets have the same cameras, of the same image size."""
    first = {key: infos[0].shapes[key] for key in infos[0].camera_keys}
    for info in infos[1:]:
        own = {key: info.shapes[key] for key in info.camera_keys}
        if own != first:
            raise DatasetError(
                f"The datasets '{infos[0].root}' and '{info.root}' cannot be learned together: one has the "
                f"images {first}, the other {own}. Collect both with the same cameras and image_size."
            )

"""Demonstrations of every task of a run, each in a dataset of its own."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from roboverse_learn.config.schema import TrainRunConfig

if TYPE_CHECKING:
    from roboverse_learn.data.collection.collect import CollectionSummary


def collect_tasks(config: TrainRunConfig) -> dict[str, "CollectionSummary"]:
    """Completes the dataset of each task of a run; returns what was collected by task."""
    from roboverse_learn.collect import collect_dataset
    from roboverse_learn.commands.tasks_at_once import collect_in_parallel

    each = {task: of_task(config, task) for task in config.tasks}
    collect_in_parallel(list(each.values()))
    return {task: collect_dataset(one) for task, one in each.items()}


def of_task(config: TrainRunConfig, task: str) -> TrainRunConfig:
    """Returns the configuration of one task of a run, without the others."""
    if len(config.tasks) == 1:
        return config
    return replace(config, env=config.env.replace(task=task), policy=replace(config.policy, tasks=()))


def num_collected(config: TrainRunConfig) -> int:
    """Returns how many demonstrations of the first task of a run are there."""
    from roboverse_learn.collect import dataset_folder
    from roboverse_learn.data.dataset.info import DatasetInfo
    from roboverse_learn.data.dataset.schema import INFO_PATH

    folder = dataset_folder(config)
    return DatasetInfo.open(folder).num_episodes if (folder / INFO_PATH).is_file() else 0


def collection_facts(collected: dict[str, "CollectionSummary"]) -> dict[str, Any]:
    """Returns what a run's manifest says of its demonstrations: ``folder`` is one, or one per task."""
    summaries = list(collected.values())
    roots = {task: summary.root for task, summary in collected.items()}
    return {
        "dataset_hash": joined_hash([summary.dataset_hash for summary in summaries]),
        "num_episodes": sum(summary.num_episodes for summary in summaries),
        "folder": summaries[0].root if len(roots) == 1 else roots,
        "success_rate": sum(summary.success_rate for summary in summaries) / len(summaries),
    }


def joined_hash(hashes: Sequence[str]) -> str:
    """Returns the hash of several datasets in their order; of one, its own."""
    return hashes[0] if len(hashes) == 1 else hashlib.sha256(" ".join(hashes).encode()).hexdigest()


def in_words(collected: dict[str, "CollectionSummary"]) -> "CollectionSummary | str":
    """Returns what a report says: the summary of one dataset, or a sentence on several."""
    if len(collected) == 1:
        return next(iter(collected.values()))
    each = ", ".join(f"{task} {summary.num_episodes:,}" for task, summary in collected.items())
    frames = sum(summary.num_frames for summary in collected.values())
    return f"Demonstrations of {len(collected)} tasks, {frames:,} frames: {each}."

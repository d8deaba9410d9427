"""Settings that a command takes from the dataset that it is given, where nobody gives others."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from roboverse_learn.config.command_line_keys import FROM
from roboverse_learn.config.serialize import env_keys, task_names
from roboverse_learn.data.dataset.info import DatasetInfo, is_collected_here
from roboverse_learn.data.dataset.schema import INFO_PATH

_SCENE = ("task", "task_kwargs", "robot", "scenario")
"""Fields of the environment that episodes of a merged or edited dataset still name."""

_IMAGES = ("cameras", "image_size")


def values_of_dataset(command: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Returns what a command takes from its dataset.

    Args:
        command: Its name. ``train dataset=`` takes the scene and the images, but for a suite, which names its
            tasks itself. ``collect from=`` takes the images, so that what is made of demonstrations can be
            merged with them; a preset that is given has images of its own.
        given: What is typed, by key.
    """
    if command == "collect" and "preset" not in given:
        origin = str(given.get("from") or given.get(FROM) or "")
        recorded = recorded_values(origin, []) if origin else {}
        return {key: recorded[key] for key in _IMAGES if key in recorded}
    if command != "train" or not given.get("dataset") or given.get("suite"):
        return {}
    tasks = task_names(given["task"]) if given.get("task") else []
    of_another = {"level": "only", "only": "level"}  # a scene varies by one of them
    recorded = recorded_values(str(given["dataset"]), tasks)
    return {key: value for key, value in recorded.items() if of_another.get(key) not in given}


def recorded_values(folder: str, tasks: Sequence[str]) -> dict[str, Any]:
    """Returns the settings that a dataset was recorded with, as values of ``train``.

    Args:
        folder: The dataset's folder.
        tasks: Tasks that are given; empty takes the dataset's.

    Returns:
        The environment of a collection of ours, and its ``steps_per_look``. Of a dataset that was merged or
        edited since, the scene and the robot, as far as all episodes have the same. Nothing where there is no
        dataset, or where it is of another task than the first that is given.

    Raises:
        DatasetError: The dataset is damaged, or has no episode.
    """
    from roboverse_learn.data.collection.schedule import read_record

    root = Path(folder)
    if not (root / INFO_PATH).is_file():
        return {}
    if is_collected_here(root):
        settings, _ = read_record(root)
    else:
        settings = _common(DatasetInfo.open(root).episode_metadata)
    if tasks and settings.get("task", tasks[0]) != tasks[0]:
        return {}
    values = {key: settings[key] for key in env_keys("train") if settings.get(key) is not None}
    steps = settings.get("steps_per_look")
    return values | ({"collect": {"steps_per_look": steps}} if steps else {})


def _common(episodes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Returns what all episodes say of their scene; of several tasks, the robot alone."""
    first = episodes[0]
    same = [key for key in _SCENE if key in first and all(each.get(key) == first[key] for each in episodes)]
    return {key: first[key] for key in same if "task" in same or key == "robot"}

"""Settings that a command takes from the dataset that it is given, where nobody gives others."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from envs.core.observation_keys import IMAGE_PREFIX
from roboverse_learn.config.command_line_keys import FROM
from roboverse_learn.config.serialize import env_keys, task_names
from roboverse_learn.data.dataset.info import DatasetInfo, is_collected_here
from roboverse_learn.data.dataset.schema import INFO_PATH

_SCENE = ("task", "task_kwargs", "robot", "scenario")
"""Fields of the environment that episodes of a merged or edited dataset still name."""

_HAS_IMAGES = ("preset", "recipe", "run")
"""Keys that decide which images there are, where nobody names cameras or an image size."""


def values_of_dataset(command: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Returns what a command takes from its dataset.

    Args:
        command: Its name. ``train dataset=`` takes the scene and the images, but for a suite, which names its
            tasks itself. ``collect from=`` and ``train from=`` take the images, so that what is made of
            demonstrations can be merged with them; a preset, a recipe or a run that is given has its own.
        given: What is typed, by key.

    Raises:
        DatasetError: The dataset is damaged, or has no episode.
    """
    origin = str(given.get("from") or given.get(FROM) or "")
    if command == "train" and given.get("dataset"):
        if given.get("suite"):
            return {}
        tasks = task_names(given["task"]) if given.get("task") else []
        of_another = {"level": "only", "only": "level"}  # a scene varies by one of them
        recorded = recorded_values(str(given["dataset"]), tasks)
        return {key: value for key, value in recorded.items() if of_another.get(key) not in given}
    if command in ("collect", "train") and origin and not any(given.get(key) for key in _HAS_IMAGES):
        return _images(Path(origin))
    return {}


def _images(root: Path) -> dict[str, Any]:
    """Returns the cameras and the image size of a dataset; nothing where it has none, or of two sizes."""
    if not (root / INFO_PATH).is_file():
        return {}
    info = DatasetInfo.open(root)
    shapes = {key.removeprefix(IMAGE_PREFIX): info.shapes[key] for key in info.camera_keys}
    sizes = {min(height, width) for height, width, _ in shapes.values()}
    return {"cameras": [*shapes], "image_size": sizes.pop()} if len(sizes) == 1 else {}


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

"""The dataset of ``train dataset=``: collected here, edited by another program, or of another robot.

It is read and never written.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import policies
from envs.core.errors import ConfigError, RoboVerseError
from envs.core.observation_keys import IMAGE_PREFIX
from envs.robots import ROBOTS
from roboverse_learn.commands.collected import of_task
from roboverse_learn.commands.dataset_layout import task_layout
from roboverse_learn.commands.learned_robots import (
    Learned,
    episode_robots,
    learned_in,
    moves_joints,
    other_robots,
    plain_joints,
    robot_name,
)
from roboverse_learn.config.schema import TrainRunConfig
from roboverse_learn.data.collection.schedule import check_settings, read_record
from roboverse_learn.data.dataset.info import DatasetInfo, is_collected_here
from roboverse_learn.data.dataset.raw import check_all_raw, dataset_hash, has_raw
from roboverse_learn.data.dataset.schema import ACTION_KEY, STATE_KEY, Feature
from roboverse_learn.data.sources.base import DemonstrationSource

log = logging.getLogger(__name__)

_ENVIRONMENT_STATE_KEY = "observation.environment_state"


@dataclass(frozen=True)
class GivenDataset:
    """A dataset to train on.

    Attributes:
        info: What it says of itself.
        config: The run's configuration, with the cameras and the image size of the dataset.
        level: Randomization level of the demonstrations; None where unknown, or where one channel varied.
        only: The channel that varied alone in them.
        misfit: Why the policy cannot be evaluated in the run's tasks, one sentence; empty where it can.
    """

    info: DatasetInfo
    config: TrainRunConfig
    level: int | None
    only: str | None
    misfit: str = ""

    @cached_property
    def hash(self) -> str:
        """:func:`~roboverse_learn.data.dataset.raw.dataset_hash`."""
        return dataset_hash(self.info.root)

    @property
    def learned(self) -> dict[str, list[str]]:
        """What a run records of it: ``robots`` and ``actions`` of :class:`Learned`, and its ``tasks``."""
        found, collected = learned_in(self.info), is_collected_here(self.info.root)
        tasks = list(self.config.tasks) if collected else self.info.named_tasks
        return {"robots": list(found.robots), "actions": list(found.actions), "tasks": tasks}

    @property
    def words(self) -> str:
        """One sentence for the report."""
        return (
            f"Read {self.info.num_episodes} demonstrations, {self.info.num_frames:,} frames, of "
            f"'{self.info.root}'."
        )


def find_given(config: TrainRunConfig) -> GivenDataset | None:
    """Returns the dataset that a run names and learns from; None where it names none, or learns from an env.

    Raises:
        RoboVerseError: as :func:`given_dataset`.
    """
    learns = bool(config.dataset) and policies.learns_from(config.policy_name) == "dataset"
    return given_dataset(config) if learns else None


def given_dataset(config: TrainRunConfig) -> GivenDataset:
    """Opens the dataset of ``config.dataset``, whoever wrote it.

    Raises:
        DatasetError: There is none, it is damaged or empty, or was collected here with other settings.
        ConfigError: Its episodes are of another task, or of several that the policy cannot tell apart, or
            its joints are those of other robots alone.
    """
    info = DatasetInfo.open(config.dataset)
    if has_raw(info):
        check_all_raw(info)
    if is_collected_here(info.root):
        _check_same(info, config)
        return GivenDataset(info, config, None if config.env.only else config.env.level, config.env.only)
    _check_tasks(info, config)
    _check_robots(info, config)
    variations = {(each.get("level"), each.get("only")) for each in info.episode_metadata}
    level, only = variations.pop() if len(variations) == 1 else (None, None)
    try:
        fitted = _as_seen(info, config)
        misfit = next(filter(None, (_misfit(info, fitted, task) for task in config.tasks)), "")
    except RoboVerseError as error:
        fitted, misfit = config, _sentence(config.env.task, str(error).rstrip("."))
    if not misfit and (other := _other_robot(info, config)):
        log.warning("%s", other)
    return GivenDataset(info, config if misfit else fitted, level, only, misfit)


def _check_same(info: DatasetInfo, config: TrainRunConfig) -> None:
    """Checks that a collection of ours has the settings that are given.

    Raises:
        DatasetError: Some differ.
    """
    before, _ = read_record(info.root)
    now = DemonstrationSource(config).settings()
    if before.get("task") == config.env.task:  # no camera is named where the task's first one is taken
        before, now = (each | {"cameras": _seen(config, each.get("cameras") or ())} for each in (before, now))
    unusual = ("robot", "simulator_settings", "scenario", "steps_per_look")  # left out where they are not
    check_settings(info.root, before, now, keys={*now, *unusual}, advice=_advice(config))


def _advice(config: TrainRunConfig) -> str:
    """Returns what to do where a run has other settings than its dataset."""
    if config.recipe:
        return f"recipe={config.recipe} counts as given: leave it out, or name a dataset of its settings."
    if len(config.tasks) > 1:
        return "Give those of the dataset, or name one that has all tasks of the run."
    return "Leave out what differs to take the dataset's, or name another dataset."


def _seen(config: TrainRunConfig, cameras: Sequence[str]) -> list[str]:
    """Returns the names of the cameras that ``cameras=`` means in the first task of a run."""
    return [camera.name for camera in config.env.make_task().scenario.seen_by(cameras).cameras]


def _other_robot(info: DatasetInfo, config: TrainRunConfig) -> str:
    """Returns a sentence where a policy acts with a robot that is in no episode; else nothing."""
    robots, _all_named = episode_robots(info)
    if robots:
        here, others = robot_name(config.env, config.env.robot), other_robots(Learned(robots), config.env)
    else:  # of another program, which says at most the kind that LeRobot knows
        _, _, here = task_layout(config)
        named = all(robot.lerobot_type for robot in config.env.make_task().robots)
        others = [info.robot_type] if named and info.robot_type not in (None, "", here) else []
    if not others:
        return ""
    return (
        f"dataset={info.root} was recorded with {' and '.join(others)}, and the policy is evaluated with "
        f"{here}. robot= names the robot of the evaluation."
    )


def _check_tasks(info: DatasetInfo, config: TrainRunConfig) -> None:
    """Checks that episodes that name their task name one of the run, and no other that it would learn too."""
    named = info.named_tasks
    if named and not set(named) & set(config.tasks):
        raise ConfigError(
            f"dataset={info.root} is of {', '.join(named)}, and the run is of {', '.join(config.tasks)}. Add "
            f"task={named[0]}."
        )
    others = [task for task in named if task not in config.tasks]
    if others and not policies.learns_several(config.policy_name):
        raise ConfigError(
            f"dataset={info.root} has episodes of {', '.join(others)}, too, and policy={config.policy_name} "
            f"reads no instruction that would tell them from {', '.join(config.tasks)}. Give a dataset of "
            "one task, or take policy=mtact."
        )


def _check_robots(info: DatasetInfo, config: TrainRunConfig) -> None:
    """Checks that episodes that name their robots name that of the run, where the actions are of joints."""
    robots, all_named = episode_robots(info)
    others = other_robots(Learned(robots), config.env) if all_named else []
    if others and moves_joints(config.env.make_task()):
        here = robot_name(config.env, config.env.robot)
        one = next((f"Give robot={name}, or name" for name in others if name in ROBOTS), "Name")
        raise ConfigError(
            f"dataset={info.root} holds demonstrations of {' and '.join(others)}, and the run is of {here}, "
            f"where the same joint positions are another posture. {one} a dataset that holds demonstrations "
            f"of {here}, too."
        )


def _as_seen(info: DatasetInfo, config: TrainRunConfig) -> TrainRunConfig:
    """Returns a configuration with the cameras and the image size of a dataset.

    Raises:
        ConfigError: Its images are not square, differ in size, or are too small or too large.
    """
    shapes = {key: sorted(info.shapes[key]) for key in info.camera_keys}  # the channels are the smallest
    sizes = {tuple(shape[1:]) for shape in shapes.values()}
    if not sizes:
        return config
    height, width = min(sizes)
    if len(sizes) > 1 or height != width:
        shown = ", ".join(f"{key} {shape[1]} x {shape[2]}" for key, shape in shapes.items())
        raise ConfigError(f"the images of the dataset are not square and of one size: {shown}")
    cameras = tuple(key.removeprefix(IMAGE_PREFIX) for key in info.camera_keys)
    return replace(config, env=config.env.replace(cameras=cameras, image_size=height))


def _misfit(info: DatasetInfo, config: TrainRunConfig, task: str) -> str:
    """Returns why the policy of a dataset cannot act in a task; empty where it can."""
    features, _, _ = task_layout(of_task(config, task))
    for key in (STATE_KEY, ACTION_KEY):
        theirs, ours = info.features.get(key), features[key]
        if theirs is None:  # of which the policy speaks itself
            continue
        if (here := _words(ours)) != (there := _words(theirs)):
            return _sentence(task, f"its {key} has {here} numbers, and that of the dataset {there}")
        names = theirs.get("names")
        if isinstance(names, list) and plain_joints(names) != plain_joints(ours["names"]):
            return _sentence(task, f"its {key} is {ours['names']}, and that of the dataset {names}")
    if _ENVIRONMENT_STATE_KEY in info.features:
        return _sentence(task, f"it has no {_ENVIRONMENT_STATE_KEY}, which the dataset has")
    return ""


def _words(vector: Feature) -> str:
    """Returns the shape of a vector or an array, such as ``7`` or ``2 x 7``."""
    return " x ".join(map(str, vector["shape"]))


def _sentence(task: str, reason: str) -> str:
    return f"The policy is not evaluated, for it cannot act in {task}: {reason.strip()}."

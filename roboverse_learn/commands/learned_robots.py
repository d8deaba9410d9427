"""The robots whose demonstrations a checkpoint learned, as far as its run, or its dataset, says so."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from envs.core.errors import DatasetError, PolicyError
from envs.robots import ROBOTS
from envs.spec import EnvSpec
from envs.tasks.base import Task
from roboverse_learn.commands.run_folder import read_facts
from roboverse_learn.config.schema import TrainRunConfig
from roboverse_learn.data.collection.schedule import read_record
from roboverse_learn.data.dataset.info import DatasetInfo, is_collected_here
from roboverse_learn.data.dataset.raw import dataset_hash
from roboverse_learn.data.dataset.schema import ACTION_KEY

log = logging.getLogger(__name__)

_LEROBOT_CONFIG = "train_config.json"
"""What ``lerobot-train`` writes into a checkpoint beside its policy: it names the dataset."""

_NORMALIZER = "policy_preprocessor_step_*_normalizer_processor.safetensors"


@dataclass(frozen=True, slots=True)
class Learned:
    """Whose demonstrations were learned.

    Attributes:
        robots: Registered robots, the empty name that of the task itself; empty where unknown.
        actions: Names of the numbers of an action; empty where unknown.
    """

    robots: tuple[str, ...] = ()
    actions: tuple[str, ...] = ()


def learned_in_run(folder: Path, trained: TrainRunConfig) -> Learned:
    """Returns what is known of the demonstrations of a run, or of the robot that an agent acted with.

    Args:
        folder: The run's folder.
        trained: Its configuration.
    """
    if not trained.dataset:
        return Learned((trained.env.robot,))
    facts = read_facts(folder, "collect")
    if "robots" in facts:
        return Learned(tuple(map(str, facts["robots"])), tuple(map(str, facts.get("actions") or ())))
    before = facts.get("dataset_hash")  # of a run that is older than the record of its robots
    return _learned_at(Path(trained.dataset), lambda info: dataset_hash(info.root) == before)


def learned_without_run(checkpoint: Path) -> Learned:
    """Returns what is known of a checkpoint of no run: one of ``lerobot-train``, while its dataset is there.

    Args:
        checkpoint: The pretrained folder.
    """
    from policies.checkpoint import read_json

    try:
        dataset = read_json(checkpoint / _LEROBOT_CONFIG).get("dataset")
    except PolicyError:  # it is of another program
        return Learned()
    root = dataset.get("root") if isinstance(dataset, dict) else None
    if not isinstance(root, str):
        return Learned()
    return _learned_at(Path(root), lambda info: _normalizes_as(checkpoint, info))


def learned_in(info: DatasetInfo) -> Learned:
    """Returns what a dataset says of its robots: in its settings, its episodes, or its kind of robot."""
    names = info.features.get(ACTION_KEY, {}).get("names")
    actions = tuple(map(str, names)) if isinstance(names, list) else ()
    return Learned(_robots(info), actions)


def _robots(info: DatasetInfo) -> tuple[str, ...]:
    if is_collected_here(info.root):
        return (str(read_record(info.root)[0].get("robot") or ""),)
    named, all_named = episode_robots(info)
    if all_named:
        return named
    kind = info.robot_type  # of the episodes that name none, which LeRobot's tools wrote
    return tuple(sorted({*named, kind})) if kind and kind in ROBOTS else ()


def episode_robots(info: DatasetInfo) -> tuple[tuple[str, ...], bool]:
    """Returns the robots that episodes name, the empty one that of the task, and whether each names one."""
    ours = [each for each in info.episode_metadata if "task" in each]
    robots = tuple(sorted({str(each.get("robot") or "") for each in ours}))
    return robots, len(ours) == len(info.episode_metadata)


def other_robots(learned: Learned, env: EnvSpec) -> list[str]:
    """Returns the robots that were learned, where that of an environment is none of them; else nothing."""
    if not learned.robots or env.robot in learned.robots:
        return []
    there = sorted({robot_name(env, name) for name in learned.robots})
    return [] if robot_name(env, env.robot) in there else there


def robot_name(env: EnvSpec, name: str) -> str:
    """Returns a robot's own name; that of the task's own where none is given."""
    if name:
        return ROBOTS.get(name).name if name in ROBOTS else name
    return "+".join(robot.name for robot in env.replace(robot="", scenario={}).make_task().robots)


def moves_joints(task: Task) -> bool:
    """Whether the actions of a task are of joints, whose numbers mean something else on another robot."""
    joints = {name for robot in task.robots for name in robot.reading_names}
    return not joints.isdisjoint(task.controller.names)


def warn_of_joints(learned: Learned, env: EnvSpec) -> None:
    """Warns where a policy that learned joints of one robot moves those of another one, as far as known."""
    others = other_robots(learned, env)
    if not others and (learned.robots or not learned.actions):
        return
    task = env.make_task()
    if not moves_joints(task):
        return
    here, names = robot_name(env, env.robot), task.controller.names
    if others:
        log.warning(
            "The policy learned joints of '%s' and moves those of '%s', where the same positions are another "
            "posture. Train with task_kwargs.action_space=hand, whose actions are poses of the hand.",
            *("' and '".join(others), here),
        )
    elif len(names) == len(learned.actions) and plain_joints(names) != plain_joints(learned.actions):
        log.warning(
            "The policy learned the joints %s and moves %s of '%s'. Where these are not the same joints, the "
            "same positions are another posture. robot= names the robot of the evaluation.",
            *(", ".join(learned.actions), ", ".join(names), here),
        )


def recorded_robots(learned: Learned, env: EnvSpec) -> dict[str, list[str]]:
    """Returns what a result's configuration says of the robots that were learned; nothing if it is this."""
    others = other_robots(learned, env)
    return {"learned_robots": others} if others else {}


def plain_joints(names: Sequence[str]) -> list[str]:
    """Returns names of joints without what LeRobot's robots write otherwise: ``a_b.pos`` for our ``a/b``."""
    return [str(name).removesuffix(".pos").replace("/", "_") for name in names]


def _learned_at(root: Path, is_same: Callable[[DatasetInfo], bool]) -> Learned:
    """Reads a dataset that may be gone, damaged or another one by now, of which nothing is known then."""
    try:
        info = DatasetInfo.open(root)
        return learned_in(info) if is_same(info) else Learned()
    except (DatasetError, PolicyError, OSError, ValueError):
        return Learned()


def _normalizes_as(checkpoint: Path, info: DatasetInfo) -> bool:
    """Whether a checkpoint of LeRobot's normalizes actions by the statistics that a dataset has now."""
    from policies.checkpoint import read_weights

    now = info.stats.get(ACTION_KEY, {}).get("mean")
    for path in checkpoint.glob(_NORMALIZER):
        saved = read_weights(path).get(f"{ACTION_KEY}.mean")
        if saved is not None and now is not None:
            return saved.numel() == now.size and np.allclose(saved.flatten(), now.flatten(), 1e-4, 1e-6)
    return False

"""What decides that a run is not another one: the keys of its name, and how two configurations differ."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import policies
from envs.core.errors import PolicyError
from envs.core.fingerprint import digest, file_hash
from policies.checkpoint import resolve, weights_path
from roboverse_learn.commands.scene_labels import varied_part
from roboverse_learn.config.command_line_keys import at, flat_keys
from roboverse_learn.config.schema import DemonstrationConfig, TrainRunConfig
from roboverse_learn.config.serialize import to_values
from roboverse_learn.data.dataset.info import is_collected_here
from roboverse_learn.data.dataset.raw import dataset_hash
from roboverse_learn.data.dataset.schema import INFO_PATH
from roboverse_learn.training.config import AugmentConfig, TrainConfig

# What may change between two starts of one run: none of it decides what is learned.
_FREE = {
    *("device", "run", "resume", "slow_ok", "dry_run", "preset", "evaluate", "suite", "tasks_at_once"),
    *("dataset", "datasets_dir", "runs_dir", "results_dir"),
}
_FREE_KEYS = {
    *("collect.num_workers", "collect.num_envs"),
    *("train.num_threads", "train.save_every", "train.log_every", "train.wandb", "train.cuda_graphs"),
}
_EXTENDABLE = ("train.steps", "train.time_limit_s")


def identity(config: TrainRunConfig) -> dict[str, Any]:
    """Returns the flat keys and values that decide what a run learns, those of its name.

    Keys that are younger than the first runs are left out at their usual values: a run keeps its name.
    """
    return _flat(_without_usual_younger(_decisive(config), config))


def _decisive(config: TrainRunConfig) -> dict[str, Any]:
    """Returns the nested keys and values that decide what a run learns."""
    values = {key: value for key, value in to_values(config).items() if key not in _FREE}
    if len(config.tasks) == 1:
        values["policy"].pop("tasks", None)
    if given := values["train"].get("resume_from", ""):  # its path differs between machines
        values["train"]["resume_from"] = file_hash(weights_path(resolve(given)))
    return values


def _without_usual_younger(values: dict[str, Any], config: TrainRunConfig) -> dict[str, Any]:
    """Deletes younger keys at their usual values from what :func:`_decisive` returns."""
    for key in ("simulator_settings", "scenario", "recipe", "robot", "only_corrections"):
        if key in values and not values[key]:
            del values[key]
    _leave_out_usual(values["collect"], DemonstrationConfig(), ("steps_per_look",))
    _leave_out_usual(values["policy"], type(config.policy)(), getattr(config.policy, "younger", ()))
    if not values["policy"].get("wrong_instructions", True):
        del values["policy"]["wrong_instructions"]
    if not values["train"].get("resume_from", True):
        del values["train"]["resume_from"]
    _leave_out_usual(values["train"], TrainConfig(), ("mixing",))
    younger = ("hue", "convolution", "overlay", "tone", "shadow", "swap", "swap_camera")
    _leave_out_usual(values["train"].get("augment", {}), AugmentConfig(), younger)
    return values


def _flat(values: dict[str, Any]) -> dict[str, Any]:
    return {key: at(values, key) for key in flat_keys(values) if key not in _FREE_KEYS}


def _leave_out_usual(values: dict[str, Any], usual: Any, younger: Iterable[str]) -> None:
    """Deletes younger keys that have their usual values: without them a run keeps its name."""
    for key in younger:
        if key in values and values[key] == getattr(usual, key):
            del values[key]


def run_name(config: TrainRunConfig) -> str:
    """Returns the name of the run of a configuration, such as ``quick-level0-seed0-1a2b3c4d``."""
    if is_of_others(config):  # what is learned follows from its content alone, whose level is unknown
        decides = {**identity(config), "dataset_hash": dataset_hash(config.dataset)}
        return f"{config.preset}-seed{config.seed}-{digest(decides)}"
    varied = varied_part(config.env)
    return f"{config.recipe or config.preset}-{varied}-seed{config.seed}-{digest(identity(config))}"


def is_of_others(config: TrainRunConfig) -> bool:
    """Whether a run learns from a dataset that is given and is of no collection of ours."""
    root, learns = Path(config.dataset), policies.learns_from(config.policy_name)
    return (
        learns == "dataset" and bool(config.dataset) and (root / INFO_PATH).is_file()
    ) and not is_collected_here(root)


def changes_of_result(before: TrainRunConfig, now: TrainRunConfig) -> str:
    """Returns :func:`changes` since a result, whose run may have begun with a checkpoint that is gone."""
    try:
        return changes(before, now)
    except PolicyError:
        begun = [each.train.resume_from or "nothing" for each in (now, before)]
        return "train.resume_from={}, it has {}".format(*begun)


def changes(before: TrainRunConfig, now: TrainRunConfig) -> str:
    """Returns which keys decide that a run is not another one; empty where they are the same."""
    old, new = _flat(_decisive(before)), _flat(_decisive(now))
    changed = [key for key in {**new, **old} if key not in _EXTENDABLE and old.get(key) != new.get(key)]
    if "policy_name" in changed:
        changed = ["policy_name"]  # whose other keys are its own
    return "; ".join(f"{key}={new.get(key)}, it has {old.get(key)}" for key in changed)

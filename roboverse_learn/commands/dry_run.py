"""What ``roboverse train ... dry_run=true`` prints: what is there, what is missing, and all settings."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import policies
from policies.base import listed
from roboverse_learn.commands.collected import num_collected, of_task
from roboverse_learn.commands.columns import columns
from roboverse_learn.commands.run_folder import CONFIG_FILE, config_text, find_run
from roboverse_learn.commands.run_list import run_facts
from roboverse_learn.config.schema import TrainRunConfig

if TYPE_CHECKING:
    from roboverse_learn.training.learners import Learner


def planned(learner: "Learner") -> str:
    """Returns the stages of a run, each with what it finds, and the run's settings as YAML.

    Args:
        learner: Of the run, whose settings are checked.

    Raises:
        ConfigError: The run cannot begin, as one in a folder with other files.
        DatasetError: What demonstrations are made from cannot be read.
    """
    folder, config = find_run(learner.config)
    config = replace(config, dry_run=False)  # as the run itself is started
    rows = [("run", _state(folder)), *_demonstrations(config), ("train", _training(config, learner.device))]
    rows.append(("evaluate", _evaluation(config)))
    said = "\n".join(columns(rows))
    return f"dry_run=true: nothing is written.\n{said}\n\n{config_text(config)}"


def _state(folder: Path) -> str:
    if not (folder / CONFIG_FILE).exists():
        return f"{folder} (new)"
    state, steps, success = run_facts(folder)
    found = f"{state}, {steps} steps" + ("" if success == "-" else f", {success}")
    return f"{folder} ({found})"


def _demonstrations(config: TrainRunConfig) -> list[tuple[str, str]]:
    from roboverse_learn.collect import dataset_folder
    from roboverse_learn.data.sources import SOURCES

    if policies.learns_from(config.policy_name) != "dataset":
        return []
    if config.dataset:
        return [("learn from", config.dataset)]
    rows = []
    for task in config.tasks:
        one = of_task(config, task)
        there, wanted = num_collected(one), config.collect.num_demos
        if there < wanted:
            source = SOURCES.get(one.source)(one)
            source.check()
            source.candidates()  # reads what demonstrations are made from
        rows.append(("collect", f"{dataset_folder(one)} ({min(there, wanted):,} of {wanted:,} are there)"))
    return rows


def _training(config: TrainRunConfig, device: str) -> str:
    train = config.train
    of = f"steps of {train.batch_size:,} samples"
    if policies.learns_from(config.policy_name) != "dataset":
        of = "environment steps"
    limit = "" if train.time_limit_s is None else f", at most {train.time_limit_s:g} s"
    return f"{config.policy_name} on {device}: {train.steps:,} {of}{limit}"


def _evaluation(config: TrainRunConfig) -> str:
    from roboverse_learn.commands.tested_checkpoint import protocol_of

    protocol = protocol_of(config.evaluate)
    cells = len(list(protocol.cells())) * len(config.tasks)
    chosen = f"levels={listed(map(str, protocol.levels))} splits={listed(protocol.splits)}"
    counted = f"{cells:,} cell{'s' * (cells != 1)} of {protocol.episodes:,} episodes"
    return f"{chosen}, {counted} into {config.results_dir}"

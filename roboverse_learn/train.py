"""``python roboverse_learn/train.py policy=act task=PickCube``: from nothing to the leaderboard.

Collect what is missing, train, evaluate over levels and splits, write results, leaderboard, plots and
videos. A policy that learns from an env (``policy=ppo``) collects nothing. Every stage continues where a
killed one stopped, so the same command finishes the run.
"""

import sys
from pathlib import Path

if __name__ == "__main__":  # as a script: this folder's `data` or `run` must not hide other packages
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import logging
import os
import shlex
import time
from typing import TYPE_CHECKING, Any

import policies
from envs.core.errors import ConfigError, ResultError
from roboverse_learn.commands.outcomes import Evaluation, TrainedRun
from roboverse_learn.config.schema import TrainRunConfig

if TYPE_CHECKING:
    from roboverse_learn.commands.given_dataset import GivenDataset
    from roboverse_learn.commands.run_folder import RunFolder
    from roboverse_learn.data.collection.collect import CollectionSummary
    from roboverse_learn.training.learners import Demonstrations, Learner
    from roboverse_learn.training.reporter import TrainResult

log = logging.getLogger(__name__)

LONG_RUN_S = 3600.0
"""A run whose training alone takes longer on this machine asks first."""

_POLL_S = 1.0


def train(config: TrainRunConfig) -> Any:
    """Runs the whole loop; returns a printable report. See :func:`train_run`."""
    from roboverse_learn.commands.report import train_report

    if config.dry_run:
        return _dry_run(config)
    run = train_run(config)
    return "" if run is None else train_report(run)


def train_run(config: TrainRunConfig) -> TrainedRun | None:
    """Runs the whole loop; None in other processes than the first of ``accelerate launch``.

    A dataset that is named is trained on as it is, whoever made it. Where its policy cannot act in the task,
    as that of another robot, nothing is evaluated.

    Under ``accelerate launch`` the first process collects and evaluates, and all of them train.

    Raises:
        ConfigError: The run would take very long on this machine, is open in another process, was started
            with another configuration, or is to be logged to Weights & Biases and nobody is logged in; the
            task has no reward, or has no expert, that an agent is to learn from; it is a dry run, which
            only the command line has.
        MissingExtraError: A package is not installed.
    """
    from roboverse_learn.commands.called_with import command_words
    from roboverse_learn.commands.given_dataset import find_given
    from roboverse_learn.commands.run_folder import RunFolder

    if config.dry_run:
        raise ConfigError(
            "dry_run=true is of the command line, as in: roboverse train task=PickCube dry_run=true"
        )
    _check_several_processes(config)
    from_dataset = policies.learns_from(config.policy_name) == "dataset"
    given = find_given(config)
    config = given.config if given else config
    if from_dataset and int(os.environ.get("RANK", "0")) > 0:
        _train_along(config)
        return None
    device = _checked_learner(config).device
    started = time.monotonic()
    with RunFolder.open(config, ["roboverse", "train", *command_words()]) as run:
        log.info("Run: %s", run.folder)
        misfit = given.misfit if given else ""
        if misfit:
            log.warning("%s", misfit)
        root, collected = _collect(config, run) if from_dataset and not given else (None, None)
        if given:
            _read(given, run)
            root = str(given.info.root)
        with run.stage("train") as facts:
            trained = _train(config, run.folder, root, device)
            facts.update(steps=trained.steps, stopped_by=trained.stopped_by)
            if trained.loss is not None:  # a run that was complete before has no new one
                facts.update(loss=trained.loss)
        evaluations = [] if misfit else _evaluate(config, run, trained.checkpoint)
        shown = _show(config, run, evaluations) if evaluations else {"board": {}}
        stages = dict(run.stages)
    return TrainedRun(
        folder=run.folder,
        dataset=given.words if given else collected,
        trained=trained,
        evaluations=tuple(evaluations),
        note=misfit,
        stages=stages,
        seconds=time.monotonic() - started,
        **shown,
    )


def _dry_run(config: TrainRunConfig) -> str:
    """Checks a run as :func:`train_run` does; returns what it would do."""
    from roboverse_learn.commands.dry_run import planned
    from roboverse_learn.commands.given_dataset import find_given

    _check_several_processes(config)
    given = find_given(config)
    return planned(_checked_learner(given.config if given else config))


def _checked_learner(config: TrainRunConfig) -> "Learner":
    """Returns the learner of a run about which all is checked that can be before it begins."""
    from roboverse_learn.commands.new_run import new_run_words
    from roboverse_learn.config.preflight import check_installed
    from roboverse_learn.training.device import resolve_device
    from roboverse_learn.training.learners import learner_of
    from roboverse_learn.training.metrics import check_wandb

    if new := new_run_words(config.run):
        log.info("%s", new)
    device = resolve_device(config.device)
    check_installed(config.env)
    learner = learner_of(config, device)
    learner.check()
    _check_looks(config)
    if few := learner.too_few_steps():
        log.warning("%s", few)
    try:
        refuse_long_run(learner)
    except ConfigError as error:
        if not config.dry_run:
            raise
        log.warning("%s", error)
    if config.train.wandb:
        check_wandb()
    return learner


def _check_looks(config: TrainRunConfig) -> None:
    """Finds the materials and files that the scenes of training and evaluation name."""
    from roboverse_learn.config.preflight import check_materials, check_scenario_files

    materials = {"evaluate.materials": config.evaluate.materials}
    if policies.learns_from(config.policy_name) == "dataset":
        materials = {"materials": config.env.materials, **materials}
    for each in materials.values():
        check_materials(each)
    check_scenario_files(config.env, materials)


def refuse_long_run(learner: "Learner") -> None:
    """Stops a full-size run without a GPU before it has begun.

    Raises:
        ConfigError: Training would take longer than :data:`LONG_RUN_S`, ``slow_ok`` is false, and the preset
            is not ``quick``, which is meant for any machine, also one that is busy now.
    """
    config, limit = learner.config, learner.config.train.time_limit_s
    ends_in_time = limit is not None and limit <= LONG_RUN_S
    if learner.device != "cpu" or config.slow_ok or ends_in_time:
        return
    log.info("Timing policy=%s on this machine.", config.policy_name)
    seconds = learner.estimate_s()
    if seconds > LONG_RUN_S and config.preset != "quick":
        raise ConfigError(
            f"Training alone will take about {_duration(seconds)} on this machine's CPU. Take a GPU that "
            "torch can use, preset=quick for the whole loop in minutes, or add "
            "slow_ok=true to start all the same."
        )
    log.info("%s", _forecast(config, seconds))


def _forecast(config: TrainRunConfig, training_s: float) -> str:
    """Says how long the run will take; of one whose other stages are not known, the training alone."""
    from roboverse_learn.commands.run_estimate import beside_training

    others = beside_training(config) if policies.learns_from(config.policy_name) == "dataset" else None
    if others is None:
        return f"Training will take about {_duration(training_s)}."
    in_all = others.collect_s + training_s + others.evaluate_s
    return (
        f"This run will take about {_duration(in_all)}: {_duration(others.collect_s)} to collect, "
        f"{_duration(training_s)} to train, {_duration(others.evaluate_s)} to evaluate."
    )


def _collect(config: TrainRunConfig, run: "RunFolder") -> "tuple[Demonstrations, CollectionSummary | str]":
    """Collects what is missing; returns the folder, or that of each task, and what a report says."""
    from roboverse_learn.commands.collected import collect_tasks, collection_facts, in_words

    with run.stage("collect") as facts:
        collected = collect_tasks(config)
        facts.update(collection_facts(collected))
    return facts["folder"], in_words(collected)


def _read(given: "GivenDataset", run: "RunFolder") -> None:
    """Records the dataset that is given as the run's.

    Raises:
        ConfigError: The run began with other demonstrations.
    """
    with run.stage("collect") as facts:
        before = facts.get("dataset_hash", given.hash)
        if before != given.hash:
            raise ConfigError(
                f"The run '{run.folder}' was started with the demonstrations {before[:16]}, and "
                f"'{given.info.root}' holds {given.hash[:16]}. Add resume=false to start a run beside it."
            )
        facts.update(dataset_hash=given.hash, num_episodes=given.info.num_episodes)
        facts.update(folder=str(given.info.root), level=given.level, only=given.only, **given.learned)


def _evaluate(config: TrainRunConfig, run: "RunFolder", checkpoint: Path) -> list[Evaluation]:
    """Evaluates a checkpoint in its tasks."""
    from policies.checkpoint import check_learned
    from roboverse_learn.commands.tasks_at_once import evaluate_in_parallel
    from roboverse_learn.commands.tested_checkpoint import checkpoint_of_run
    from roboverse_learn.config.schema import EvaluateConfig
    from roboverse_learn.evaluate import evaluate_checkpoint

    results = Path(config.results_dir)
    with run.stage("evaluate") as facts:
        tested = checkpoint_of_run(run.folder, config, checkpoint)
        for task in config.tasks:  # a dataset of several tasks may lack the one that is named
            check_learned(checkpoint, task, other_tasks=config.evaluate.other_tasks)
        evaluate_in_parallel(
            EvaluateConfig(
                checkpoint=str(run.folder),
                device=config.device,
                results_dir=config.results_dir,
                evaluate=config.evaluate,
                tasks_at_once=config.tasks_at_once,
            ),
            config.tasks,
        )
        evaluations = [
            evaluate_checkpoint(tested.with_task(task), config.evaluate, results, "train")
            for task in config.tasks
        ]
        facts.update(results=[str(each.path) for each in evaluations])
    return evaluations


def _show(config: TrainRunConfig, run: "RunFolder", evaluations: list[Evaluation]) -> dict[str, Any]:
    """Makes the GIF and the leaderboard; returns the fields of :class:`TrainedRun` that are of them."""
    from benchmark.gifs import usual_of_each_level, write_gif
    from roboverse_learn.leaderboard import write_leaderboard_of

    gif = None
    try:
        with run.stage("leaderboard"):
            shown = usual_of_each_level(evaluations[0].videos, evaluations[0].result.cells())
            gif = write_gif(run.folder / "policy.gif", shown)
            return {"gif": gif, "board": write_leaderboard_of(Path(config.results_dir), evaluations)}
    except (ConfigError, ResultError) as error:  # the run is whole, whatever other files of the folder hold
        after = f"roboverse leaderboard results_dir={shlex.quote(config.results_dir)}"
        said = f"{error}\nThis run is complete, without a leaderboard. Mend the above, then run: {after}"
        return {"gif": gif, "board": {}, "board_failure": said}


def _train(
    config: TrainRunConfig, folder: Path, dataset: "Demonstrations | None", device: str
) -> "TrainResult":
    """Trains in this process, on demonstrations or in an environment."""
    from roboverse_learn.commands.run_folder import seed_of
    from roboverse_learn.training.learners import learner_of
    from roboverse_learn.training.reporter import ProgressReporter, Reporter

    first = int(os.environ.get("RANK", "0")) == 0
    reporter = ProgressReporter() if first else Reporter()
    try:
        return learner_of(config, device).learn(folder, dataset, seed_of(config, "training"), reporter)
    finally:
        if isinstance(reporter, ProgressReporter):
            reporter.close()


def _check_several_processes(config: TrainRunConfig) -> None:
    """Checks that all processes of ``accelerate launch`` name the same folder.

    Raises:
        ConfigError: They are to name the first one that is free, which the first of them takes.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) > 1 and not config.resume and not config.run:
        raise ConfigError(
            "resume=false begins a run in a new folder, and each process of accelerate launch would choose "
            "its own. Name a new folder for all of them: add run=<folder>."
        )


def _train_along(config: TrainRunConfig) -> None:
    """Trains beside the first process of ``accelerate launch``, which has the dataset."""
    from roboverse_learn.commands.run_folder import default_folder, read_facts
    from roboverse_learn.training.device import resolve_device

    folder = Path(config.run) if config.run else default_folder(config)
    while not (facts := read_facts(folder, "collect")) or facts.get("status") != "done":
        time.sleep(_POLL_S)
    _train(config, folder, facts["folder"], resolve_device(config.device))


def _duration(seconds: float) -> str:
    """A duration for people."""
    if seconds < 5400:
        minutes = max(1, round(seconds / 60))
        return f"{minutes} minute{'s' * (minutes > 1)}"
    return f"{seconds / 3600:.0f} hours" if seconds < 172_800 else f"{seconds / 86_400:.1f} days"


if __name__ == "__main__":
    from roboverse_learn.cli import script

    script("train")

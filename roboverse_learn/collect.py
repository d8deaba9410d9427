"""``python roboverse_learn/collect.py task=PickCube``: demonstrations of the expert into a dataset.

With ``source=policy checkpoint=<run>`` they are those of a policy that learned the task by reward, and
with ``source=<format> path=<file or folder>`` those of a file, replayed in our environment.
"""

import sys
from pathlib import Path

if __name__ == "__main__":  # as a script: this folder's `data` or `run` must not hide other packages
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import contextlib
import dataclasses
import os
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from envs.spec import EnvSpec
from roboverse_learn.config.keys import flat_keys
from roboverse_learn.config.preflight_installed import check_installed
from roboverse_learn.config.preflight_materials import check_materials, folder_name
from roboverse_learn.config.preflight_scenario import check_scenario_files
from roboverse_learn.config.scenario_overrides import control_hz, learned_hz, scenario_name
from roboverse_learn.config.schema import CollectConfig

if TYPE_CHECKING:
    from roboverse_learn.data.collection.collect import CollectionSummary
    from roboverse_learn.data.importers.verdicts import ImportSummary
    from roboverse_learn.data.sources.policy import Demonstrator

EXPERT_SOURCE = "roboverse_learn.data.sources.expert:make_expert_source"
POLICY_SOURCE = "roboverse_learn.data.sources.policy:make_policy_source"
IMPORT_SOURCE = "roboverse_learn.data.sources.importer:make_import_source"

_ROUNDS = 3
"""How often every environment of every process may fail before a collection ends without hope."""


def collect(config: CollectConfig) -> Any:
    """Collects demonstrations; returns a printable report. Killed, the same call continues.

    Raises:
        TooFewSuccessesError: Many episodes were tried, and none or too few succeeded.
        DatasetError: The dataset was begun with other settings, is damaged, or the disk is full.
    """
    from roboverse_learn.commands.report import collection_report

    return collection_report(collect_dataset(config))


def dataset_folder(config: CollectConfig) -> Path:
    """Returns the folder of the dataset of a configuration."""
    if config.dataset:
        return Path(config.dataset)
    varied = f"{config.env.only}-alone" if config.env.only else f"level{config.env.level}"
    size, demos = f"{config.env.image_size}px", f"{config.collect.num_demos}demos"
    name = "-".join([varied, config.env.simulator, config.env.renderer, *config.env.cameras, size, demos])
    if config.source == "policy":
        name += f"-{_demonstrator(config).policy}-{_demonstrator(config).weights[:8]}"
    elif config.source != "expert":
        name += f"-{config.source}-{Path(config.path).name.partition('.')[0]}-by-{config.replay}"
    # Of a folder, its name alone: where it lies is this machine's affair.
    changed = [*sorted(config.env.task_kwargs.items()), *sorted(config.env.simulator_settings.items())]
    options = [f"{key}={Path(str(value)).name}" for key, value in changed]
    if config.env.scenario:
        options.append(scenario_name(config.env.scenario))
    if config.env.materials:
        options.append(folder_name(config.env.materials))
    return Path(config.datasets_dir) / config.env.task / "-".join([name, *options])


def collect_dataset(config: CollectConfig) -> "CollectionSummary":
    """Makes sure that the dataset of a configuration is complete, with a progress bar."""
    check_installed(config.env)
    check_materials(config.env.materials)
    check_scenario_files(config.env, {"materials": config.env.materials})
    if config.source == "policy":
        _check_control_rate(config)
        return _collect_episodes(config, None)
    if config.source == "expert":
        _demand_expert(config)
        return _collect_episodes(config, None)
    from roboverse_learn.data.importers.verdicts import write_summary

    imported = _judge(config)
    summary = _collect_episodes(config, imported)
    write_summary(Path(summary.root), imported)
    return dataclasses.replace(summary, imported=imported)


def _demand_expert(config: CollectConfig) -> None:
    from envs.core.errors import ConfigError
    from envs.tasks import TASKS

    if not TASKS.get(config.env.task).has_expert:
        raise ConfigError(
            f"{config.env.task} has no scripted expert to collect from. Learn it by reward, as in: "
            f"roboverse train policy=ppo task={config.env.task}"
        )


def _demonstrator(config: CollectConfig) -> "Demonstrator":
    """Returns the policy that demonstrates."""
    from roboverse_learn.data.sources.policy import find_demonstrator

    return find_demonstrator(config.checkpoint, config.env.task)


def _check_control_rate(config: CollectConfig) -> None:
    """Refuses a policy whose actions were meant to last longer or shorter than those of the dataset."""
    from envs.core.errors import ConfigError
    from roboverse_learn.commands.run_folder import read_config, run_of

    folder = run_of(_demonstrator(config).checkpoint)
    if folder is None:
        return
    trained = read_config(folder)
    learned = learned_hz(trained, config.env.task)
    asked = control_hz(config.env)
    if learned != asked:
        changes = trained.env.scenario.get("physics", {})
        words = [f"scenario.physics.{key}={value}" for key, value in changes.items()]
        remedy = f"Add {' '.join(words)}." if words else "Leave out scenario.physics."
        raise ConfigError(
            f"The policy of '{folder}' learned at {learned:g} control steps per second, and {asked:g} were "
            f"asked for. {remedy}"
        )


def _judge(config: CollectConfig) -> "ImportSummary":
    """Replays every demonstration of a file without pictures, which tells which of them to collect."""
    import envs
    from roboverse_learn.data.importers.verdicts import find_files, judge, known_summary

    conditions = {key: getattr(config.env, key) for key in ("task", "task_kwargs", "simulator")}
    conditions |= _tuning(config)
    given = {"source": config.source, "path": Path(config.path), "replay": config.replay}
    find_files(config.source, Path(config.path))  # a wrong path is told before a simulator starts
    known = known_summary(dataset_folder(config), **given, conditions=conditions)
    if known is not None:
        return known
    env = envs.make_vec(**conditions, num_envs=config.collect.num_envs, split="train")
    with contextlib.closing(env), _bar("replaying") as show:
        return judge(
            **given, env=env, conditions=conditions, on_progress=lambda done, known: show(done, known, "")
        )


def _collect_episodes(config: CollectConfig, imported: "ImportSummary | None") -> "CollectionSummary":
    from envs.randomization.splits import load_split
    from roboverse_learn.data.collection.collect import CollectionConfig, CollectionProgress
    from roboverse_learn.data.collection.collect import collect as collect_episodes
    from roboverse_learn.data.collection.schedule import GIVE_UP_AFTER, TooFewSuccessesError

    keys = ("task", "task_kwargs", "level", "only", "simulator", "renderer", "cameras", "image_size")
    scene = {key: getattr(config.env, key) for key in keys} | {"materials": config.env.materials or None}
    scene |= _tuning(config)
    kwargs: dict[str, Any] = scene | {"num_envs": config.collect.num_envs}
    source, settings, target = EXPERT_SOURCE, scene, config.collect.num_demos
    candidates = [int(index) for index in load_split("train").episodes]
    if config.source == "policy":
        from roboverse_learn.training.device import resolve_device

        demonstrator = _demonstrator(config)
        source, settings = POLICY_SOURCE, scene | demonstrator.identity()
        kwargs |= {
            "checkpoint": str(demonstrator.checkpoint),
            "identity": demonstrator.identity(),
            "device": resolve_device("auto"),
        }
    if imported is not None:
        passing = imported.chosen()
        source, candidates = IMPORT_SOURCE, [verdict.episode for verdict in passing]
        settings, target = scene | imported.identity(), min(target, len(passing))
        kwargs |= imported.identity() | {
            "root": str(Path(config.path) if Path(config.path).is_dir() else Path(config.path).parent),
            "demonstrations": {str(verdict.episode): (verdict.file, verdict.name) for verdict in passing},
        }
    features, fps, robot = dataset_layout(config)
    workers = min(config.collect.num_workers or _default_workers(config), len(candidates))
    collection = CollectionConfig(
        root=dataset_folder(config),
        num_episodes=target,
        candidates=candidates,
        source=source,
        source_kwargs=kwargs,
        fps=fps,
        features=features,
        robot_type=robot,
        num_workers=workers,
        batch_size=config.collect.num_envs,
        settings=settings,
        fewer_ok=imported is not None,
        give_up_after=max(GIVE_UP_AFTER, _ROUNDS * workers * config.collect.num_envs),
    )
    with _bar("collecting") as show:

        def report(now: CollectionProgress) -> None:
            text = f"{100 * now.success_rate:.1f} % succeed, {now.frames_per_s:.0f} frames/s"
            show(now.num_episodes, target, text)

        try:
            return collect_episodes(collection, report)
        except TooFewSuccessesError as error:
            raise TooFewSuccessesError(f"{error} {_what_helps(config)}") from error


def _what_helps(config: CollectConfig) -> str:
    """Says what to change where too few episodes succeed."""
    if config.source == "policy":
        return f"The policy of '{config.checkpoint}' needs more training, or learned in another scene."
    usual = EnvSpec()
    keys = [key for key in ("level", "only", "simulator") if getattr(config.env, key) != getattr(usual, key)]
    for section in ("task_kwargs", "simulator_settings", "scenario"):
        keys += flat_keys(getattr(config.env, section), f"{section}.")
    if keys:
        return f"Leave out, or make easier, what differs from the task's own scene: {', '.join(keys)}."
    if config.source == "expert":
        return f"Measure the expert with: python -m envs.experts.check task={config.env.task}"
    return "Try the other way to replay: replay=states or replay=controls."


def _tuning(config: CollectConfig) -> dict[str, Any]:
    """Returns what is changed of the scene and the simulator: of neither, a dataset says nothing of them."""
    tuning = {"simulator_settings": config.env.simulator_settings, "scenario": config.env.scenario}
    return {key: values for key, values in tuning.items() if values}


@contextlib.contextmanager
def _bar(what: str) -> Iterator[Callable[[int, int, str], None]]:
    """Shows a progress bar; yields what is called with the number done, the number in all, and words."""
    from rich import progress

    with progress.Progress(
        progress.TextColumn(what),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TextColumn("{task.description}"),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
    ) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, total, text: bar.update(task, completed=done, total=total, description=text)


def _default_workers(config: CollectConfig) -> int:
    """One process per core; one alone where a simulator steps all environments at once, as on a GPU."""
    from envs.simulators import HANDLERS

    return 1 if HANDLERS.get(config.env.simulator).steps_together else len(os.sched_getaffinity(0))


def dataset_layout(config: CollectConfig) -> tuple[dict[str, Any], int, str]:
    """Returns the features, the frames per second and the robot of a task's dataset."""
    from roboverse_learn.data.dataset.schema import make_features

    task = config.env.make_task()
    scenario = task.scenario.seen_by(config.env.cameras, config.env.image_size)
    robot = scenario.robots[0]
    cameras = {camera.name: (camera.height, camera.width) for camera in scenario.cameras}
    features = make_features(robot.joint_names, task.controller.names, cameras)
    return features, round(scenario.physics.control_hz), robot.name


if __name__ == "__main__":
    from roboverse_learn.cli import script

    script("collect")

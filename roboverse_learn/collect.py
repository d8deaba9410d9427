"""``python roboverse_learn/collect.py task=PickCube``: demonstrations of the expert into a dataset.

With ``source=policy checkpoint=<run>`` they are those of a policy that was trained by reinforcement learning,
with ``source=<format> path=<file or folder>`` those of a file, replayed in our environment, and with
``source=teleop path=<folder>`` those of a person, recorded by ``roboverse teleoperate``. With
``source=augment from=<dataset>`` they are made from a few others, with ``source=retarget from=<dataset>``
another robot follows the hand of the recorded one, and with ``source=rerender from=<dataset>`` the states of
others are rendered again.
"""

import sys
from pathlib import Path

if __name__ == "__main__":  # as a script: this folder's `data` or `run` must not hide other packages
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from envs.core.errors import ConfigError
from roboverse_learn.commands.dataset_layout import task_layout
from roboverse_learn.commands.scene_labels import folder_name, scenario_name, varied_part
from roboverse_learn.config.preflight import check_installed, check_materials, check_scenario_files
from roboverse_learn.config.schema import CollectConfig
from roboverse_learn.data.sources import SOURCES

if TYPE_CHECKING:
    from roboverse_learn.data.collection.collect import CollectionSummary

_ROUNDS = 3
"""Failures of every environment of every process after which a collection may give up."""


def collect(config: CollectConfig) -> Any:
    """Collects demonstrations of a task, or of each of a suite; returns a printable report.

    Killed, the same call continues.

    Raises:
        TooFewSuccessesError: Many episodes were tried, and none or too few succeeded.
        DatasetError: The dataset was started with other settings, is damaged, or the disk is full.
    """
    from roboverse_learn.commands.report import collection_report

    if config.suite:
        from roboverse_learn.commands.suite import collect_suite
        from roboverse_learn.commands.suite_report import suite_collection_report

        return suite_collection_report(collect_suite(config, collect_dataset))
    return collection_report(collect_dataset(config))


def dataset_folder(config: CollectConfig) -> Path:
    """Returns the folder of the dataset of a configuration."""
    if config.dataset:
        return Path(config.dataset)
    source = SOURCES.get(config.source)(config)
    scene = [varied_part(config.env), config.env.simulator, config.env.renderer, *config.env.cameras]
    parts = [f"{config.env.image_size}px", source.count_part(), source.name_part()]
    # Of a folder, its name alone: its path differs between machines.
    changed = [*sorted(config.env.task_kwargs.items()), *sorted(config.env.simulator_settings.items())]
    options = [f"robot={config.env.robot}"] if config.env.robot else []
    options += [f"{key}={Path(str(value)).name}" for key, value in changed]
    if config.collect.steps_per_look:
        options.append(f"{config.collect.steps_per_look}steps_per_look")
    if config.env.scenario:
        options.append(scenario_name(config.env.scenario))
    if config.env.materials:
        options.append(folder_name(config.env.materials))
    return Path(config.datasets_dir) / config.env.task / "-".join([*scene, *filter(None, parts), *options])


def collect_dataset(config: CollectConfig) -> "CollectionSummary":
    """Completes the dataset of a configuration, with a progress bar."""
    from roboverse_learn.data.collection.collect import CollectionProgress
    from roboverse_learn.data.collection.collect import collect as collect_episodes
    from roboverse_learn.data.collection.config import CollectionConfig
    from roboverse_learn.data.collection.limits import num_encoders, within_machine
    from roboverse_learn.data.collection.schedule import GIVE_UP_AFTER, TooFewSuccessesError

    _check_recordable(config)
    check_installed(config.env)
    check_materials(config.env.materials)
    check_scenario_files(config.env, {"materials": config.env.materials})
    config = within_machine(config)
    source = SOURCES.get(config.source)(config)
    source.check()
    root = dataset_folder(config)
    source.prepare(root, _bar)
    candidates = source.candidates()
    target = config.collect.num_demos
    if source.num_demos_is_most:
        target = min(target, len(candidates))
    features, fps, robot = task_layout(config)
    workers = min(config.collect.num_workers, len(candidates))
    collection = CollectionConfig(
        root=root,
        num_episodes=target,
        candidates=candidates,
        source=source.episodes,
        source_kwargs=source.arguments(),
        fps=fps,
        features=features,
        robot_type=robot,
        num_workers=workers,
        num_encoders=num_encoders(config),
        batch_size=config.collect.num_envs,
        settings=source.settings(),
        fewer_ok=source.num_demos_is_most,
        give_up_after=max(GIVE_UP_AFTER, _ROUNDS * workers * config.collect.num_envs),
    )
    with _bar("collecting") as show:

        def report(now: CollectionProgress) -> None:
            show(
                min(now.num_episodes, target), target, now.rates
            )  # the folder may have more than is asked for

        try:
            summary = collect_episodes(collection, report)
        except TooFewSuccessesError as error:
            raise TooFewSuccessesError(f"{error} {source.advice()}") from error
    words = source.outcome(summary.num_episodes, summary.num_attempts)
    if summary.num_episodes > config.collect.num_demos:
        words += f"; the dataset had them before, and num_demos={config.collect.num_demos} takes none away"
    return dataclasses.replace(summary, outcome=words, imported=source.finish(root))


def _check_recordable(config: CollectConfig) -> None:
    """Checks that the source records what the task observes.

    Raises:
        ConfigError: The task's observation is another benchmark's, and the source records joints and images
            as the cameras see them.
    """
    if "observation_space" not in config.env.task_kwargs:
        return
    task, source = config.env.make_task(), SOURCES.get(config.source)
    if source.native_observations or not (task.mirrored_images or task.state_names != task.reading_names):
        return
    others = [name for name in SOURCES.names() if SOURCES.get(name).native_observations]
    raise ConfigError(
        f"source={config.source} records positions of joints and images as the cameras see them. Leave out "
        "task_kwargs.observation_space (task_kwargs.action_space may stay), or collect with source="
        f"{' or '.join(others)}."
    )


@contextlib.contextmanager
def _bar(what: str) -> Iterator[Callable[[int, int, str], None]]:
    """Shows the progress; yields a function of the number done, the number in all, and a text."""
    from roboverse_learn.progress import StageProgress

    with StageProgress(what) as progress:
        yield progress.update


if __name__ == "__main__":
    from roboverse_learn.cli import script

    script("collect")

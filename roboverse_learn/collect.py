"""``python roboverse_learn/collect.py task=PickCube``: demonstrations of the expert into a dataset."""

import sys
from pathlib import Path

if __name__ == "__main__":  # as a script: this folder's `data` or `run` must not hide other packages
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import os
from typing import TYPE_CHECKING, Any

from roboverse_learn.config import CollectConfig

if TYPE_CHECKING:
    from roboverse_learn.data.collection import CollectionSummary

SOURCE = "roboverse_learn.data.expert_source:make_expert_source"


def collect(config: CollectConfig) -> Any:
    """Collects demonstrations; returns a printable report. Killed, the same call continues.

    Raises:
        DatasetError: The dataset was begun with other settings, is damaged, or the disk is full.
    """
    from roboverse_learn.report import collection_report

    return collection_report(collect_dataset(config))


def dataset_folder(config: CollectConfig) -> Path:
    """Returns the folder of the dataset of a configuration."""
    if config.dataset:
        return Path(config.dataset)
    varied = f"{config.only}-alone" if config.only else f"level{config.level}"
    name = (
        f"{varied}-{config.simulator}-{config.renderer}-{config.image_size}px-{config.collect.num_demos}demos"
    )
    options = [f"{key}={value}" for key, value in sorted(config.task_kwargs.items())]
    options += [Path(config.materials).name] if config.materials else []
    return Path(config.datasets_dir) / config.task / "-".join([name, *options])


def collect_dataset(config: CollectConfig) -> "CollectionSummary":
    """Makes sure that the dataset of a configuration is complete, with a progress bar."""
    from rich import progress

    from envs.randomization.splits import load_split
    from roboverse_learn.data.collection import CollectionConfig, CollectionProgress
    from roboverse_learn.data.collection import collect as collect_episodes

    keys = ("task", "task_kwargs", "level", "only", "simulator", "renderer", "image_size")
    scene = {key: getattr(config, key) for key in keys} | {"materials": config.materials or None}
    features, fps, robot = dataset_layout(config)
    collection = CollectionConfig(
        root=dataset_folder(config),
        num_episodes=config.collect.num_demos,
        candidates=[int(index) for index in load_split("train").episodes],
        source=SOURCE,
        source_kwargs=scene | {"num_envs": config.collect.num_envs},
        fps=fps,
        features=features,
        robot_type=robot,
        num_workers=config.collect.num_workers or len(os.sched_getaffinity(0)),
        settings=scene,
    )
    with progress.Progress(
        progress.TextColumn("collecting"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TextColumn("{task.description}"),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
    ) as bar:
        task = bar.add_task("", total=config.collect.num_demos)

        def show(now: CollectionProgress) -> None:
            text = f"{100 * now.success_rate:.1f} % succeed, {now.frames_per_s:.0f} frames/s"
            bar.update(task, completed=now.num_episodes, description=text)

        return collect_episodes(collection, show)


def dataset_layout(config: CollectConfig) -> tuple[dict[str, Any], int, str]:
    """Returns the features, the frames per second and the robot of a task's dataset."""
    from envs.tasks import TASKS
    from roboverse_learn.data.schema import make_features

    task = TASKS.get(config.task)(**config.task_kwargs)
    scenario = task.scenario
    robot = scenario.robots[0]
    size = (config.image_size, config.image_size)
    cameras = {camera.name: size for camera in scenario.cameras}
    features = make_features(robot.joint_names, task.controller.names, cameras)
    return features, round(scenario.physics.control_hz), robot.name


if __name__ == "__main__":
    from roboverse_learn.cli import script

    script("collect")

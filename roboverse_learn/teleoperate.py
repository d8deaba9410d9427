"""``python roboverse_learn/teleoperate.py task=PickCube``: a person at a browser steers the hand."""

import sys
from pathlib import Path

if __name__ == "__main__":  # as a script: this folder's `data` or `run` must not hide other packages
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import dataclasses
import logging
import shlex
from typing import TYPE_CHECKING, Any

from roboverse_learn.commands.words_of_config import collect_words
from roboverse_learn.config.preflight import check_installed, check_materials, check_scenario_files
from roboverse_learn.config.schema import CollectConfig, DemonstrationConfig, TeleoperateConfig

if TYPE_CHECKING:
    from roboverse_learn.data.collection.collect import CollectionSummary

log = logging.getLogger(__name__)


def teleoperate(config: TeleoperateConfig) -> Any:
    """Records episodes until there are enough, then renders them as a dataset; returns a printable report.

    Killed at any moment, it loses the episode that runs; the same call continues.

    Raises:
        ConfigError: The task cannot be teleoperated, or the port is taken.
        DatasetError: The folder holds recordings of another scene.
    """
    config = with_checkpoint(config)
    from roboverse_learn.teleoperation.report import episodes_table, expert_quality, teleoperation_report
    from roboverse_learn.teleoperation.run import prepared, steer_by_expert, steer_by_page

    check_installed(config.env)
    check_materials(config.env.materials)
    check_scenario_files(config.env, {"materials": config.env.materials})
    folder = recordings_folder(config)
    figures = None
    with prepared(config, folder) as steering:
        if done := steering.nothing_to_do:
            log.info("%s", done)
        elif config.actor == "expert":
            steer_by_expert(steering)
        else:
            figures = steer_by_page(steering, config)
        rows, kept = steering.book.rows(), steering.book.kept
        table = episodes_table(rows, expert_quality(steering.env, rows))
    dataset = render(config, folder) if config.render and kept else None
    again = collect_command(config, folder) if kept else ""
    return teleoperation_report(table, folder, dataset, figures, again)


def with_checkpoint(config: TeleoperateConfig) -> TeleoperateConfig:
    """Returns the configuration with the environment that its checkpoint was trained in, if it names one.

    Level and materials stay those of the configuration.

    Raises:
        PolicyError: There is no checkpoint, or it learned other tasks.
    """
    if not config.checkpoint:
        return config
    from roboverse_learn.teleoperation.policy_driver import find_policy

    given = config.env
    env = find_policy(config).env.replace(level=given.level, only=given.only, materials=given.materials)
    return dataclasses.replace(config, env=env)


def recordings_folder(config: TeleoperateConfig) -> Path:
    """Returns the folder of the recordings of a configuration: its level and images do not matter."""
    if config.recordings:
        return Path(config.recordings)
    env = config.env
    changes = (env.task_kwargs, env.robot, env.scenario, env.simulator_settings)
    is_own = not any(changes) and env.simulator == "mujoco"
    name = "recordings" if is_own else f"recordings-{env.replace(**_LOOKS).hash[:8]}"
    name = name.replace("recordings", "corrections", 1) if config.checkpoint else name
    return Path(config.datasets_dir) / env.task / name


_FEW = 10
"""Episodes that one process renders; more are rendered by one process per core."""

_LOOKS: dict[str, Any] = {
    "renderer": "warp",
    "cameras": (),
    "image_size": 256,
    "level": 0,
    "only": None,
    "materials": "",
}


def render(config: TeleoperateConfig, folder: Path) -> "CollectionSummary":
    """Renders the successes of a folder as a dataset, with the configuration's level, cameras and size."""
    from roboverse_learn.collect import collect_dataset

    return collect_dataset(collect_config(config, folder))


def collect_config(config: TeleoperateConfig, folder: Path) -> CollectConfig:
    """Returns the configuration of ``roboverse collect`` that renders a folder of recordings."""
    few = config.num_demos <= _FEW  # rendered before other processes have started
    return CollectConfig(
        env=config.env,
        datasets_dir=config.datasets_dir,
        dataset=config.dataset,
        source="teleop",
        path=str(folder),
        collect=DemonstrationConfig(num_demos=config.num_demos, num_envs=4, num_workers=int(few)),
    )


def collect_command(config: TeleoperateConfig, folder: Path) -> str:
    """Returns the command, quoted for a shell, that renders the recordings again, at another level."""
    again = CollectConfig(
        env=config.env.replace(level=3, only=None),
        datasets_dir=config.datasets_dir,
        source="teleop",
        path=str(folder),
    )
    return shlex.join(["roboverse", "collect", *collect_words(again)])


if __name__ == "__main__":
    from roboverse_learn.cli import script

    script("teleoperate")

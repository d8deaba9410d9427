"""Checks before a run, so that a mistake is reported before anything is written."""

import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import policies
from envs.core.atomic import file_in_place_of_folder, not_a_folder
from envs.core.errors import ConfigError, RoboVerseError, suggest
from envs.spec import EnvSpec
from roboverse_learn.config.schema import CollectConfig, TrainRunConfig
from roboverse_learn.data.dataset.info import datasets_in
from roboverse_learn.data.dataset.recovery import refuse_other_files
from roboverse_learn.data.dataset.schema import INFO_PATH

_FOLDER_KEYS = ("dataset", "datasets_dir", "recordings", "run", "runs_dir", "results_dir", "out")
_A_FILE = "the path of a file, or package:path for one inside an installed package"
_A_MATERIAL = "the name of a material, or of an image in the folder that {}=+<folder> adds"


def check_working_folder() -> None:
    """Checks that the folder in which a command was started still exists.

    Raises:
        ConfigError: It was removed or moved.
    """
    try:
        os.getcwd()
    except FileNotFoundError as error:
        raise ConfigError(
            "The folder in which you are was removed or moved. Change to one that exists, as by: cd ~"
        ) from error


def check_folders(config: Any) -> None:
    """Checks that no folder of a configuration is a file or in one, and that those to write can be written.

    Raises:
        ConfigError: A file is where a folder is meant, a folder cannot be made or written, or there is no
            dataset to train on.
        DatasetError: The folder to collect into holds other files.
        ResultError: The folder for results is one of other things.
    """
    for key in _FOLDER_KEYS:
        given = getattr(config, key, "")
        if not given:
            continue
        try:
            file = file_in_place_of_folder(Path(given))
            if file is None and key in _written_keys(config):
                _try_writing(Path(given))
        except OSError as error:
            shown = given if len(given) < 100 else f"{given[:100]}…"
            raise ConfigError(f"{key}={shown}: {error.strerror}. Choose another folder.") from error
        if file is not None:
            raise ConfigError(f"{key}={given}: {not_a_folder(file)}")
    results_dir = getattr(config, "results_dir", "")
    if results_dir and Path(results_dir).is_dir():
        from benchmark.leaderboard.results_folder import check_results_folder

        check_results_folder(Path(results_dir))
    if isinstance(config, TrainRunConfig) and config.dataset:
        _check_there(Path(config.dataset), Path(config.datasets_dir))
    elif isinstance(config, CollectConfig) and config.dataset:
        refuse_other_files(Path(config.dataset))


def _check_there(folder: Path, datasets_dir: Path) -> None:
    """Checks that there is a dataset to train on."""
    if (folder / INFO_PATH).is_file():
        return
    known = datasets_in(folder, folder.parent, datasets_dir, *datasets_dir.glob("*"))
    raise ConfigError(
        f"dataset={folder}: there is no dataset ({INFO_PATH} is missing).{suggest(str(folder), known)} Check "
        "the path, collect it with roboverse collect, or leave out dataset= to collect one now."
    )


def _written_keys(config: Any) -> tuple[str, ...]:
    """Returns the keys of folders that a command writes, whatever else it does."""
    keys = ("results_dir", "out", "run" if getattr(config, "run", "") else "runs_dir")
    return (*keys, "dataset" if config.dataset else "datasets_dir") if _collects(config) else keys


def _collects(config: Any) -> bool:
    """Whether a command writes a dataset: collect, and train without one that is given."""
    if not isinstance(config, TrainRunConfig):
        return isinstance(config, CollectConfig)
    return not config.dataset and policies.learns_from(config.policy_name) == "dataset"


def _try_writing(path: Path) -> None:
    """Makes and removes a folder in the first folder of a path that exists."""
    existing = next(each for each in (path, *path.absolute().parents) if each.is_dir())
    os.rmdir(tempfile.mkdtemp(prefix=".roboverse-", dir=existing))


def check_installed(env: EnvSpec) -> None:
    """Imports the simulator and the renderer of an environment, and finds the files of its robot.

    Raises:
        MissingExtraError: A package of one is not installed; it says how to install it.
        MissingAssetError: The robot's asset folder is not on this machine; it says how to get it.
    """
    from envs.mjcf.robots import robot_spec
    from envs.robots import ROBOTS
    from envs.simulators import HANDLERS, RENDERERS

    HANDLERS.get(env.simulator)
    (RENDERERS if env.renderer in RENDERERS else HANDLERS).get(env.renderer)
    if env.robot:
        robot_spec(ROBOTS.get(env.robot))


def check_materials(materials: str) -> None:
    """Reads a folder of materials.

    Args:
        materials: The folder, with or without ``+`` before it; empty for the built-in materials.

    Raises:
        ConfigError: It does not exist, has too few images, or one that cannot be read.
    """
    from envs.randomization.materials import MaterialLibrary
    from envs.randomization.splits import load_split

    if materials:
        load_split("train", MaterialLibrary.chosen(materials))


def check_scenario_files(env: EnvSpec, materials: Mapping[str, str]) -> None:
    """Finds every file and material that the changes of a scene name, and compiles a scene with new files.

    Args:
        env: The environment whose scene is changed.
        materials: Keys of materials and their values; each must have the materials that are named.

    Raises:
        ConfigError: One is missing, or no scene can be made of a file.
    """
    if not env.scenario:
        return
    from envs.core.assets import resolve
    from envs.randomization.materials import MaterialLibrary
    from envs.scenario.named import named
    from envs.scenario.units import AssetRef, MaterialName

    own = env.replace(scenario={}).make_task().scenario
    scene = env.make_task().scenario
    checks: list[tuple[Any, Callable[[str], object], str]] = [(AssetRef, resolve, _A_FILE)]
    for key, folder in materials.items():
        checks.append((MaterialName, MaterialLibrary.chosen(folder).texture, _A_MATERIAL.format(key)))
    files = []
    for kind, find, wanted in checks:
        known = set(named(own, kind))
        for key, name in named(scene, kind):
            try:
                if (key, name) not in known:
                    find(name)
                    files += [f"{key}={name}"] if kind is AssetRef else []
            except RoboVerseError as error:
                raise ConfigError(f"{key}={name}: give {wanted}. {error}") from error
    if files:
        _compile(scene, " ".join(files))


def _compile(scene: Any, given: str) -> None:
    """Compiles a scene with other files than the task's."""
    from envs.mjcf.model import build_model

    try:
        build_model(scene, simplify=False)
    except (RoboVerseError, ValueError) as error:  # MuJoCo's message has several lines
        reason = " ".join(str(error).split()).rstrip(".")
        raise ConfigError(
            f"{given}: no scene can be made of it. {reason}. Give a file that fits the rest of the scene, or "
            "change that, too."
        ) from error

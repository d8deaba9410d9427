"""Tells a missing or broken file, or a missing material, of a changed scene before anything is written."""

from collections.abc import Callable, Mapping
from typing import Any

from envs.core.errors import ConfigError, RoboVerseError
from envs.spec import EnvSpec

_A_FILE = "the path of a file, or package:path for one inside an installed package"
_A_MATERIAL = "the name of a material, or of a picture in the folder that {}=+<folder> adds"


def check_scenario_files(env: EnvSpec, materials: Mapping[str, str]) -> None:
    """Looks for every file and material that changes of a task's scene name, and reads the files.

    Args:
        env: The environment whose scene is changed.
        materials: Keys of materials and their values; each must know the materials that are named.

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
        _make_scene(scene, " ".join(files))


def _make_scene(scene: Any, given: str) -> None:
    """Compiles a scene with other files than the task's."""
    from envs.mjcf.model import build_model

    try:
        build_model(scene, simplify=False)
    except (RoboVerseError, ValueError) as error:  # what MuJoCo raises has lines
        reason = " ".join(str(error).split()).rstrip(".")
        raise ConfigError(
            f"{given}: no scene can be made of it. {reason}. Give a file that fits the rest of the scene, or "
            "change that, too."
        ) from error

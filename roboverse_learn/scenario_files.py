"""Tells a missing file or material of a changed scene before anything is collected, trained or evaluated."""

from collections.abc import Callable, Mapping
from typing import Any

from envs.errors import ConfigError, RoboVerseError

_A_FILE = "the path of a file, or package:path for one inside an installed package"
_A_MATERIAL = "the name of a material, or of a picture in the folder that {}=+<folder> adds"


def check_scenario_files(
    task: str, task_kwargs: Mapping[str, Any], changes: Mapping[str, Any], materials: Mapping[str, str]
) -> None:
    """Looks for every file and material that changes of a task's scene name.

    Args:
        task: Registered task.
        task_kwargs: Its options.
        changes: What is changed of its scene.
        materials: Keys of materials and their values; each must know the materials that are named.

    Raises:
        ConfigError: One is missing.
    """
    if not changes:
        return
    from envs.assets import resolve
    from envs.randomization.materials import MaterialLibrary
    from envs.scenario.named import named
    from envs.scenario.units import AssetRef, MaterialName
    from envs.tasks.making import make_task

    own = make_task(task, task_kwargs).scenario
    scene = make_task(task, task_kwargs, changes).scenario
    checks: list[tuple[Any, Callable[[str], object], str]] = [(AssetRef, resolve, _A_FILE)]
    for key, folder in materials.items():
        checks.append((MaterialName, MaterialLibrary.chosen(folder).texture, _A_MATERIAL.format(key)))
    for kind, find, wanted in checks:
        known = set(named(own, kind))
        for key, name in named(scene, kind):
            try:
                if (key, name) not in known:
                    find(name)
            except RoboVerseError as error:
                raise ConfigError(f"{key}={name}: give {wanted}. {error}") from error

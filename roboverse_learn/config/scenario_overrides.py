"""The keys ``scenario.*`` of the command line: what is changed of a task's scene."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from envs.core.errors import ConfigError
from envs.core.fingerprint import digest
from envs.spec import EnvSpec

SECTION = "scenario"

_PIXELS = ("width", "height")


@cache
def scenario_keys() -> dict[str, tuple[type, str]]:
    """Returns the dotted keys of a scene that any task may have, each with its dataclass and its field.

    Entries of a list, such as cameras, have ``<name>`` or ``<number>`` in their place. Names and sizes of
    images have keys of their own, ``cameras=`` and ``image_size=``.
    """
    from envs.scenario import CameraCfg, ScenarioCfg
    from envs.scenario.changes import keys_of

    keys = {key: (cls, name) for key, cls, name in keys_of(ScenarioCfg, SECTION)}
    return {
        key: (cls, name) for key, (cls, name) in keys.items() if cls is not CameraCfg or name not in _PIXELS
    }


def checked_scenario(
    task: str, task_kwargs: Mapping[str, Any], *changes: Mapping[str, Any], robot: str = ""
) -> dict[str, Any]:
    """Checks what is to be changed of a task's scene, without starting a simulator.

    Args:
        task: Registered task.
        task_kwargs: Its options.
        changes: What is changed, one after the other.
        robot: Robot that does the task; empty is its own.

    Returns:
        How the scene then differs from the task's own: nothing, where all is set to what it is.

    Raises:
        ConfigError: if a value is none that its key may have.
        UnknownNameError: if the scene has no such key.
    """
    if not any(changes):
        return {}
    from envs.scenario.changes import changed, difference
    from envs.tasks.make import make_task

    own = scene = make_task(task, task_kwargs, robot=robot).scenario
    for each in changes:
        _check_pixels(each.get("cameras"))
        scene = changed(scene, each)
    differs = difference(own, scene)
    make_task(task, task_kwargs, differs, robot)  # its controllers and its expert know the scene
    return differs


def _check_pixels(cameras: Any) -> None:
    for name, camera in cameras.items() if isinstance(cameras, Mapping) else ():
        for key in _PIXELS:
            if isinstance(camera, Mapping) and key in camera:
                raise ConfigError(
                    f"{SECTION}.cameras.{name}.{key}={camera[key]} was given; height and width of every "
                    "image are image_size=<pixels>."
                )


def control_hz(env: EnvSpec) -> float:
    """Returns the control steps per second of an environment."""
    return env.make_task().scenario.physics.control_hz


def learned_hz(trained: Any, task: str) -> float:
    """Returns the control steps per second at which a run learned a task.

    Args:
        trained: Configuration of the run.
        task: One of its tasks; of another one, it is those of the task that the run names first.
    """
    return control_hz(trained.env.replace(task=task) if task in trained.tasks else trained.env)


def scenario_name(changes: Mapping[str, Any]) -> str:
    """Returns the label of changes of a scene in the name of a folder or a file."""
    return f"{SECTION}-{digest(changes)}"


def folder_name(materials: str) -> str:
    """Returns the materials in the name of a dataset: ``+images`` for ``+somewhere/images``."""
    return "+" * materials.startswith("+") + Path(materials).name.removeprefix("+")


def recorded_materials(materials: str) -> str:
    """Returns the materials as a result records them: by folder name and content; empty for built-in ones.

    Raises:
        ConfigError: The folder does not exist, has too few images, or one that cannot be read.
    """
    from envs.randomization.materials import MaterialLibrary

    if not materials:
        return ""
    return f"{folder_name(materials)}-{MaterialLibrary.chosen(materials).digest()[:8]}"

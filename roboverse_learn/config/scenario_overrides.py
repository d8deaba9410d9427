"""The keys ``scenario.*`` of the command line: what is changed of a task's scene."""

from collections.abc import Mapping
from functools import cache
from typing import Any

from envs.core.errors import ConfigError

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

"""Registers the tasks with Gymnasium, for ``gymnasium.make`` and ``gymnasium.make_vec``."""

import logging

import gymnasium

from envs.core.errors import RoboVerseError
from envs.tasks import TASKS

log = logging.getLogger(__name__)


def gym_id(task: str, *, state: bool = False) -> str:
    """Returns a task's Gymnasium id, such as ``"RoboVerse/PickCube-v0"``; an id has one slash only.

    Args:
        task: Name of the task.
        state: The id of the environment that shows the whole state in place of images, such as
            ``"RoboVerse/PickCube-state-v0"``.
    """
    return f"RoboVerse/{task.replace('/', '-')}{'-state' if state else ''}-v0"


def register_envs() -> None:
    """Registers every task that Gymnasium does not know yet; ``import envs`` has done it for those here.

    A plugin that cannot be imported is a warning: names of other tasks are known all the same.
    """
    try:
        names = TASKS.names()
    except RoboVerseError as error:  # whoever looks for a name that is not there sees it again
        log.warning("%s", error)
        names = TASKS.names_so_far()
    for name in names:
        for view in ({}, {"observation": "full"}):
            env_id = gym_id(name, state=bool(view))
            if env_id not in gymnasium.registry:
                gymnasium.register(
                    id=env_id,
                    entry_point="envs.gym_env:RoboVerseEnv",
                    vector_entry_point="envs.gym_env:make_vec",
                    kwargs={"task": name, **view},
                    disable_env_checker=True,
                    order_enforce=False,
                )

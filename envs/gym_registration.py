"""Registers the tasks with Gymnasium, for ``gymnasium.make`` and ``gymnasium.make_vec``."""

import gymnasium

from envs.tasks import TASKS


def gym_id(task: str) -> str:
    """Returns a task's Gymnasium id, such as ``"RoboVerse/PickCube-v0"``; an id has one slash only."""
    return f"RoboVerse/{task.replace('/', '-')}-v0"


def register_envs() -> None:
    """Registers every task that Gymnasium does not know yet; ``import envs`` has done it for those here."""
    for name in TASKS:
        env_id = gym_id(name)
        if env_id not in gymnasium.registry:
            gymnasium.register(
                id=env_id,
                entry_point="envs.gym_env:RoboVerseEnv",
                vector_entry_point="envs.gym_env:make_vec",
                kwargs={"task": name},
                disable_env_checker=True,
                order_enforce=False,
            )

"""Tasks under the names that ``gymnasium.make`` and ``gymnasium.make_vec`` know."""

import gymnasium

from envs.tasks import TASKS


def gym_id(task: str) -> str:
    """Returns a task's name with Gymnasium, such as ``"RoboVerse/PickCube-v0"``; it knows one slash only."""
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

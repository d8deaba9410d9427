"""Scenes, simulators, tasks, randomization, and the Gymnasium environments made of them.

Importing it registers every task with Gymnasium and imports no task:
``gymnasium.make("RoboVerse/PickCube-v0")``. The distribution in ``envs/gymnasium_plugin`` imports it when
Gymnasium is first given such an id; ``gymnasium.make("envs:RoboVerse/PickCube-v0")`` needs no distribution.
"""

from typing import TYPE_CHECKING, Any

from envs.gym_registration import register_envs

if TYPE_CHECKING:
    from envs.gym_env import RoboVerseEnv, make_vec
    from envs.spec import EnvSpec
    from envs.vector_env import RoboVerseVectorEnv

_HOMES = {
    "EnvSpec": "envs.spec",
    "RoboVerseEnv": "envs.gym_env",
    "make_vec": "envs.gym_env",
    "RoboVerseVectorEnv": "envs.vector_env",
}

__all__ = ["EnvSpec", "RoboVerseEnv", "RoboVerseVectorEnv", "make_vec", "register_envs"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)


register_envs()

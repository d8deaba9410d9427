"""Other benchmarks' own protocols: how their tasks are made, and which episodes their tables count.

Other packages register protocols through the entry-point group ``roboverse.protocols``.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args, get_origin

from envs.core.errors import ConfigError
from envs.core.registry import Registry
from envs.tasks import TASKS


@dataclass(frozen=True, slots=True)
class NamedProtocol:
    """What another benchmark's evaluation does.

    Attributes:
        env: Fields of :class:`~envs.spec.EnvSpec`, as plain values.
        episodes: Episodes of each task, at level 0 of the test split.
    """

    env: Mapping[str, Any]
    episodes: int


PROTOCOLS: "Registry[NamedProtocol]" = Registry("protocol", group="roboverse.protocols")

_LIBERO = {"starts": "libero", "action_space": "native", "observation_space": "native"}
_CAMERAS = ["image", "image2"]

PROTOCOLS.add(
    "libero",
    NamedProtocol({"task_kwargs": _LIBERO, "cameras": _CAMERAS}, episodes=50),
    summary="LIBERO's 50 starts, 600 steps, robosuite's actions, LeRobot's observations",
)
PROTOCOLS.add(
    "libero_lerobot",
    NamedProtocol({"task_kwargs": {**_LIBERO, "horizon": "lerobot"}, "cameras": _CAMERAS}, episodes=50),
    summary="the same with LeRobot's limits of steps, 280 to 520 by suite",
)
PROTOCOLS.add(
    "calvin",
    NamedProtocol(
        {
            "task_kwargs": {"action_space": "native", "observation_space": "native", "looks": "meshes"},
            "cameras": ["static", "gripper"],
        },
        episodes=20,
    ),
    summary="CALVIN's actions, observations and looks, one instruction an episode; its chains with chains=",
)


def check_protocol(name: str, task: str) -> None:
    """Checks that a task has the options that a protocol sets.

    Args:
        name: Name of the protocol; empty checks nothing.
        task: Name of the task.

    Raises:
        ConfigError: It lacks one, or a value of one: it is of another benchmark.
        UnknownNameError: There is no such protocol, or no such task.
    """
    if not name:
        return
    options: Any = fields(TASKS.get(task))  # pyright: ignore[reportArgumentType]
    types = {item.name: item.type for item in options}
    wanted = PROTOCOLS.get(name).env.get("task_kwargs", {})
    missing = [key for key, value in wanted.items() if not _takes(types.get(key), value)]
    if missing:
        raise ConfigError(
            f"protocol={name} is not for {task}, which lacks its {', '.join(sorted(missing))}. Give a "
            f"task or suite of that benchmark, or leave protocol={name} out."
        )


def _takes(option: Any, value: Any) -> bool:
    """Returns whether an option of this type, None where there is none, takes a value."""
    return option is not None and (get_origin(option) is not Literal or value in get_args(option))

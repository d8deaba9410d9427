"""Tasks whose observations and actions are poses of the hand: ``task_kwargs.action_space=hand``.

A policy of one arm then moves any other that takes its place (``robot=``), for nothing names a joint. The
expert stays what it is: its joint targets are recorded as the poses that they stand for.
"""

from collections.abc import Mapping
from typing import Any

from envs.controllers import JointPositionController
from envs.core.errors import ConfigError, unknown_name
from envs.hand_target_controller import LIMITS, NAMES, HandTargetController, hand_state
from envs.tasks.base import Task

SPACES = ("joints", "hand")
"""Values of ``action_space`` of a task that has no such option of its own."""


def hand_space_parts() -> dict[str, Any]:
    """Returns what a subclass of a task replaces."""
    return {
        "action_space": "hand",
        "controller": property(lambda task: HandTargetController(task.robot)),
        "state_names": property(lambda _: NAMES),
        "state_limits": property(lambda _: LIMITS),
        "proprioception": lambda task, state: hand_state(task.robot, state.robots[task.robot.name]),
    }


def chosen_space(task: type[Task], options: Mapping[str, Any]) -> str | None:
    """Returns the action space among the options of a task; None where it is an option of its own.

    Raises:
        UnknownNameError: There is no such space.
    """
    if "action_space" not in options or "action_space" in getattr(task, "__dataclass_fields__", {}):
        return None
    space = str(options["action_space"])
    if space not in SPACES:
        raise unknown_name("action_space", space, SPACES)
    return space


def check_hand_space(task: Task) -> None:
    """Checks that a task can be done by poses of one hand.

    Raises:
        ConfigError: Several robots act, its robot has no gripper, or its actions are no joint targets.
    """
    robot = task.only_robot("action_space=hand")
    if not robot.gripper_joints or not isinstance(task.controller, JointPositionController):
        raise ConfigError(
            f"{task.name} has no action_space=hand: it needs joint targets of an arm with a gripper, and its "
            f"actions are {', '.join(task.controller.names[:8])}. Leave out task_kwargs.action_space."
        )

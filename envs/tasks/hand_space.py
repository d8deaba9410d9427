"""Action spaces of a task of one arm beside joint targets: ``task_kwargs.action_space=``.

``hand``: observations and actions are poses of the hand. A policy of one arm then moves any other that takes
its place (``robot=``), for nothing names a joint. The expert stays what it is: its joint targets are recorded
as the poses that they stand for.

``pd_joint_delta_pos`` and ``pd_ee_delta_pose``: ManiSkill's actions (:mod:`envs.tasks.delta_controllers`),
for policies of its benchmark. The expert follows its joint targets by them, and observations stay.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from envs.controllers import JointPositionController
from envs.core.errors import ConfigError, unknown_name
from envs.hand_target_controller import LIMITS, NAMES, HandTargetController, hand_state
from envs.tasks.base import Task

if TYPE_CHECKING:
    from envs.tasks.delta_controllers import JointDeltaController, PoseDeltaController
    from envs.tasks.delta_planner import DeltaPlanner

DELTA_SPACES = ("pd_joint_delta_pos", "pd_ee_delta_pose")
SPACES = ("joints", "hand", *DELTA_SPACES)
"""Values of ``action_space`` of a task that has no such option of its own."""


def space_parts(cls: type[Task], space: str) -> dict[str, Any]:
    """Returns what a subclass of a task replaces in an action space of :data:`SPACES` but for ``joints``."""
    if space in DELTA_SPACES:
        return _delta_parts(cls, space)
    return {
        "action_space": "hand",
        "controller": property(lambda task: HandTargetController(task.robot)),
        "state_names": property(lambda _: NAMES),
        "state_limits": property(lambda _: LIMITS),
        "proprioception": lambda task, state: hand_state(task.robot, state.robots[task.robot.name]),
    }


def _delta_parts(cls: type[Task], space: str) -> dict[str, Any]:
    def controller(task: Task) -> "JointDeltaController | PoseDeltaController":
        from envs.tasks.delta_controllers import JointDeltaController, PoseDeltaController

        kind = JointDeltaController if space == "pd_joint_delta_pos" else PoseDeltaController
        return kind(task.robot, task.scenario.physics.control_hz)

    def planner(task: Task) -> "DeltaPlanner":
        from envs.tasks.delta_planner import DeltaPlanner

        inner = cls.planner.__get__(task)
        return DeltaPlanner(inner, controller(task), task.robot)

    return {"action_space": space, "controller": property(controller), "planner": property(planner)}


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


def check_space(task: Task, space: str) -> None:
    """Checks that a task can be done by actions of one arm with a hand.

    Raises:
        ConfigError: Several robots act, its robot has no gripper, or its actions are no joint targets.
    """
    robot = task.only_robot(f"action_space={space}")
    if not robot.gripper_joints or not isinstance(task.controller, JointPositionController):
        raise ConfigError(
            f"{task.name} has no action_space={space}: it needs joint targets of an arm with a gripper, and "
            f"its actions are {', '.join(task.controller.names[:8])}. Leave out task_kwargs.action_space."
        )

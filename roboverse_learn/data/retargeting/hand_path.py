"""The path of a recorded robot's hand, as its joint targets command it.

Targets, and not measured positions: where the hand pushes or closes, they lead, and another arm that follows
them pushes as hard. Shapes: T = control steps, J = joints of the robot.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from envs.core.errors import ConfigError
from envs.scenario import IDENTITY, RobotCfg
from envs.state import State
from envs.tasks.base import Task
from envs.tasks.robot_columns import columns_of
from roboverse_learn.data.augmentation.pose import Pose
from roboverse_learn.data.augmentation.recording import HandReader

_GRIPPER_ACTS = 0.02
"""Share of its opening by which a gripper's target must change to be a movement."""


@dataclass(frozen=True, eq=False)
class HandPath:
    """What a hand is commanded to do.

    Attributes:
        start: Pose that the targets before the first step stand for, in the world, (1,).
        poses: Pose that the targets of each step stand for, (T,).
        half_gap_m: Commanded distance of each fingertip from the middle, m, (T,).
        first_act: First step in which the gripper begins to move; T where it never does.
    """

    start: Pose
    poses: Pose
    half_gap_m: np.ndarray
    first_act: int

    @property
    def num_steps(self) -> int:
        """T."""
        return len(self.half_gap_m)


class HandPathReader:
    """Reads hand paths from recorded states.

    Args:
        robot: The recorded robot. Where its base stands is read from the states.
    """

    def __init__(self, robot: RobotCfg) -> None:
        self._robot, self._columns = robot, columns_of(robot)
        # The chain is that of a base at the origin: a recording says where its own stands.
        self._reader = HandReader(replace(robot, pos=(0.0, 0.0, 0.0), rot=IDENTITY))

    def read(self, states: State) -> HandPath:
        """Returns the path of T + 1 recorded states.

        Raises:
            ConfigError: The states are not of this robot.
        """
        name = self._robot.name
        if name not in states.robots or states.robots[name].joint_pos.shape[1] != len(self._robot.joints):
            raise ConfigError(
                f"The recorded states are of {', '.join(states.robots) or 'no robot'}, and '{name}' with "
                f"{len(self._robot.joints)} joints was expected."
            )
        entity = states.robots[name]
        base = Pose(entity.pos[:1].cpu().double().numpy(), entity.rot[:1].cpu().double().numpy())
        targets = self._reader.starts(states)
        hands = base @ self._reader.hands(targets)
        half_gap = 0.5 * self._columns.gap(targets, self._columns.fingers)
        moves = np.abs(np.diff(half_gap)) > _GRIPPER_ACTS * 0.5 * self._robot.opening_m
        return HandPath(
            start=hands.rows(slice(0, 1)),
            poses=hands.rows(slice(1, None)),
            half_gap_m=half_gap[1:],
            first_act=int(np.argmax(moves)) if moves.any() else len(moves),
        )


def check_hands(task: Task, robots: Sequence[RobotCfg]) -> None:
    """Refuses robots without a gripper, and tasks whose actions are not joint targets.

    Raises:
        ConfigError: One is.
    """
    own = task.robot
    driven = tuple(own.joint_names[index] for index in own.driven)
    without = [robot.name for robot in robots if not robot.gripper_joints]
    if without or tuple(task.controller.names) != driven:
        why = (
            f"{without[0]} has no gripper"
            if without
            else f"the actions of {task.name} are {', '.join(task.controller.names)}"
        )
        raise ConfigError(
            f"source=retarget moves the hand of an arm by joint targets, and {why}. Use source=expert."
        )

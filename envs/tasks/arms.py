"""Base of tasks of several arms at a table, and the waypoints of one of their hands."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np

from envs.kinematics.waypoints import Waypoint
from envs.rotations import from_matrix, from_yaw, multiply, rotate
from envs.scenario import RobotCfg, Vec3
from envs.state import EntityState, State
from envs.tasks.arm_at_table import ArmAtTable, chain_at_rest, hand_axes, posed
from envs.tasks.arms_planner import ArmsPlanner, Phase
from envs.tasks.planner import Planner
from envs.tasks.tabletop import ee_pos

_HALF_TURN = np.array([0.0, 0.0, 0.0, 1.0])
"""Turn of a hand about its own z axis that exchanges its fingers, wxyz."""

DOWN: Vec3 = (0.0, 0.0, -1.0)


@dataclass(frozen=True, kw_only=True)
class ArmsAtTable(ArmAtTable):
    """Several arms at a table, which act together.

    The names of their joints, in actions and in a policy's state, begin with the robot's; each has a wrist
    camera of its own.
    """

    own_robots: ClassVar[tuple[RobotCfg, ...]]

    @property
    @override
    def robot(self) -> RobotCfg:
        return self.own_robots[0]

    @property
    @override
    def robots(self) -> tuple[RobotCfg, ...]:
        return self.own_robots

    @abstractmethod
    def phases(self, state: State, rng: np.random.Generator) -> Sequence[Phase]:
        """Returns phases that solve the task from a state of one row; ``rng`` varies them.

        In a phase all arms move at once; the next one begins when all have arrived. If the task is not solved
        at the end, the expert plans again from there. None means that it gives up.
        """

    @property
    @override
    def planner(self) -> Planner:
        return ArmsPlanner(self.robots, self.scenario.physics.control_hz, self.phases)

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the first robot's part of :meth:`phases`."""
        return [way for phase in self.phases(state, rng) for way in phase.get(self.robot.name, ())]

    def hand(self, state: State, index: int) -> "Hand":
        """Returns the hand of a robot in a state of one row."""
        robot = self.robots[index]
        return Hand(state.robots[robot.name], robot)


class Hand:
    """A robot's hand in a state of one row: it makes waypoints from poses in the world.

    Args:
        entity: The robot's state.
        robot: The robot.

    Attributes:
        name: The robot's name.
        pos: Position of the end effector, m, (3,).
        rot: Its orientation, wxyz, (4,).
    """

    def __init__(self, entity: EntityState, robot: RobotCfg) -> None:
        assert entity.ee_rot is not None, "a simulator gives every robot's end effector"
        self.name = robot.name
        self.pos, self.rot = ee_pos(entity)[0].numpy().copy(), entity.ee_rot[0].numpy().copy()
        self._robot, self._rest = robot, chain_at_rest(robot)[1]

    def to(
        self, pos: np.ndarray, rot: np.ndarray, gripper: float, duration_s: float, hold_s: float = 0.0
    ) -> Waypoint:
        """Returns a waypoint; see :func:`~envs.tasks.arm_at_table.posed`."""
        return posed(self._robot, pos, rot, gripper, duration_s, hold_s)

    def nearer(self, rot: np.ndarray) -> np.ndarray:
        """Returns an orientation (4,), with fingers exchanged where that is nearer to the posture at rest."""
        return max((rot, exchanged(rot)), key=lambda each: abs(float(np.dot(each, self._rest))))

    def stays(self, gripper: float, duration_s: float) -> Waypoint:
        """Returns a waypoint where the hand is."""
        return self.to(self.pos, self.rot, gripper, duration_s)


def exchanged(rot: np.ndarray) -> np.ndarray:
    """Returns the orientation (4,) of a hand whose fingers are exchanged."""
    return multiply(rot, _HALF_TURN)


def pointing(forward: Sequence[float] | np.ndarray, opening: Sequence[float] | np.ndarray) -> np.ndarray:
    """Returns the orientation of a hand, wxyz, (4,).

    Args:
        forward: Where its fingers point, (3,).
        opening: Line along which they open; what of it is along ``forward`` is left out, (3,).
    """
    return from_matrix(hand_axes(np.asarray(forward, np.float64), np.asarray(opening, np.float64)))


def downward(opening_rad: float) -> np.ndarray:
    """Returns the orientation of a hand that points down and opens along a heading, wxyz, (4,)."""
    return pointing(DOWN, (np.cos(opening_rad), np.sin(opening_rad), 0.0))


def in_world(entity: EntityState, point: Sequence[float] | np.ndarray) -> np.ndarray:
    """Returns a point of an entity, given in its frame, in the world, of a state of one row, m, (3,)."""
    return entity.pos[0].numpy() + rotate(entity.rot[0].numpy(), np.asarray(point, np.float64))


def facing(robot: RobotCfg, name: str, pos: Vec3, yaw_rad: float) -> RobotCfg:
    """Returns a robot under another name, at a place and turned about z."""
    w, x, y, z = (float(part) for part in from_yaw(np.array(yaw_rad)))
    return replace(robot, name=name, pos=pos, rot=(w, x, y, z))

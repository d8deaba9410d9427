"""A thing in a hand, and the waypoints of the hand that bring the thing to a pose."""

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from envs.kinematics.waypoints import Waypoint
from envs.rotations import conjugate, from_euler, from_yaw, multiply, rotate, wrapped
from envs.scenario import RobotCfg
from envs.state import EntityState, State
from envs.tasks.arm_at_table import ArmAtTable, chain_at_rest, commanded, point, posed
from envs.tasks.tabletop import GRASP_CLOSED_M, ee_pos


class Pose(NamedTuple):
    """A position, m, (3,), and an orientation, wxyz, (4,)."""

    pos: np.ndarray
    rot: np.ndarray

    @classmethod
    def of(cls, entity: EntityState) -> Self:
        """Returns the pose of an entity, of a state of one row."""
        return cls(point(entity), entity.rot[0].numpy().copy())

    @classmethod
    def level(cls, pos: np.ndarray, heading_rad: float) -> Self:
        """Returns the pose of a thing that is level, its x axis along a heading."""
        return cls(pos, from_yaw(np.array(heading_rad)))

    @property
    def ahead(self) -> np.ndarray:
        """The thing's x axis in the world, (3,)."""
        return rotate(self.rot, np.array([1.0, 0.0, 0.0]))

    def pointing(self, way: np.ndarray) -> Self:
        """Returns the pose turned as little as brings its x axis along a unit vector, (3,)."""
        ahead = self.ahead
        half = np.array([1.0 + float(ahead @ way), *np.cross(ahead, way)])
        if half[0] < 1e-6:  # opposite
            half = np.array([0.0, 0.0, 0.0, 1.0])
        return type(self)(self.pos, multiply(half / np.linalg.norm(half), self.rot))

    def rolled(self, nearest: "Pose", sides: int) -> Self:
        """Returns the pose rolled about its x axis by whole sides, as near to another as can be."""
        angles = np.pi / sides * np.arange(sides)  # halves of the turns
        options = [multiply(self.rot, np.array([np.cos(a), np.sin(a), 0.0, 0.0])) for a in angles]
        return min((type(self)(self.pos, rot) for rot in options), key=nearest.turn_to)

    def turn_to(self, other: "Pose") -> float:
        """Returns the angle between two orientations, rad."""
        w, *axis = multiply(other.rot, conjugate(self.rot))
        return 2.0 * float(np.arctan2(np.linalg.norm(axis), abs(w)))


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """A thing in a hand, of a state of one row.

    A load keeps a hand from its targets: each waypoint moves the targets by what the thing still lacks.

    Attributes:
        robot: The robot.
        now: Pose of the hand that the robot's targets stand for.
        hand: Where the hand is, m, (3,).
        pose: The thing's pose.
    """

    robot: RobotCfg
    now: Waypoint
    hand: np.ndarray
    pose: Pose

    @classmethod
    def of(cls, task: ArmAtTable, state: State, item: str) -> Self:
        """Returns an object in the hand of a task's arm."""
        hand = ee_pos(task.arm(state))[0].numpy()
        return cls(task.robot, task.commanded(state), hand, Pose.of(state.objects[item]))

    @classmethod
    def tool(cls, robot: RobotCfg, arm: EntityState) -> Self:
        """Returns the tool that an arm has in place of a hand; its pose is that of the end effector."""
        assert arm.ee_rot is not None, "a simulator gives every robot's end effector"
        pos = ee_pos(arm)[0].numpy()
        return cls(robot, commanded(robot, arm), pos, Pose(pos, arm.ee_rot[0].numpy()))

    def to(self, goal: Pose, duration_s: float, hold_s: float = 0.0) -> Waypoint:
        """Returns the waypoint that brings the thing to a pose."""
        turn = multiply(goal.rot, conjugate(self.pose.rot))
        rot = multiply(turn, multiply(from_euler(self.now.turn), chain_at_rest(self.robot)[1]))
        pos = self.now.pos + goal.pos + rotate(turn, self.hand - self.pose.pos) - self.hand
        there = posed(self.robot, pos, rot, GRASP_CLOSED_M, duration_s, hold_s)
        yaw, _, roll = (float(angle) for angle in wrapped(there.turn - self.now.turn))
        return replace(there, yaw=self.now.yaw + yaw, roll=self.now.roll + roll)

    def moved(self, way: np.ndarray, duration_s: float) -> Waypoint:
        """Returns the waypoint that moves the thing as it is by a way (3,), m."""
        return replace(self.now, pos=self.now.pos + way, gripper=GRASP_CLOSED_M, duration_s=duration_s)

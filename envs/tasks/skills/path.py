"""The way of a hand in any orientation, stop by stop, and what it does at places that are known.

A hand's orientation is a matrix whose columns are the axes of ``grip_site``: fingers open along x, z points
forward.
"""

from collections.abc import Sequence
from typing import Self

import numpy as np

from envs.kinematics.waypoints import Waypoint
from envs.rotations import from_matrix
from envs.scenario import RobotCfg
from envs.tasks.arm_at_table import posed
from envs.tasks.tabletop import GRASP_CLOSED_M, GRASP_OPEN_M


class Path:
    """Waypoints of a hand, one after another.

    Args:
        robot: The robot.
        pos: Where its hand begins, m, (3,).
        rot: Orientation of the hand there, (3, 3).
        gripper: Distance of each finger from the middle there, m.
        pace: Factor of every duration.
    """

    def __init__(
        self, robot: RobotCfg, pos: np.ndarray, rot: np.ndarray, gripper: float, pace: float = 1.0
    ) -> None:
        self._robot, self._pace = robot, pace
        self.pos, self.rot, self.gripper = pos, rot, gripper
        self.waypoints: list[Waypoint] = []

    def to(
        self,
        pos: Sequence[float] | np.ndarray,
        rot: np.ndarray | None = None,
        gripper: float | None = None,
        hold_s: float = 0.0,
        slow: float = 1.0,
    ) -> Self:
        """Adds a waypoint, whose time follows from the way; what is left out stays as it is."""
        target = np.asarray(pos, dtype=np.float64)
        rot = self.rot if rot is None else rot
        self.gripper = self.gripper if gripper is None else gripper
        cosine = np.clip((np.trace(self.rot.T @ rot) - 1.0) / 2.0, -1.0, 1.0)
        length, angle = float(np.linalg.norm(target - self.pos)), float(np.arccos(cosine))
        seconds = self._pace * slow * (0.15 + max(1.7 * length, 0.55 * angle))
        self.waypoints.append(posed(self._robot, target, from_matrix(rot), self.gripper, seconds, hold_s))
        self.pos, self.rot = target, rot
        return self

    def grasp(self, pos: np.ndarray) -> Self:
        """Opens the fingers, moves on to a place, and closes them there."""
        self.to(self.pos, gripper=GRASP_OPEN_M).to(pos, hold_s=0.05)
        return self.to(pos, gripper=GRASP_CLOSED_M, hold_s=0.25)

    def let_go(self) -> Self:
        """Opens the fingers, and draws the hand back from what lies between them."""
        self.to(self.pos, gripper=GRASP_OPEN_M, hold_s=0.2)
        return self.to(self.pos - 0.09 * self.rot[:, 2])

    def push(self, start: np.ndarray, end: np.ndarray, *after: np.ndarray, slow: float = 1.5) -> Self:
        """Pushes, pulls or presses with closed fingers along a line.

        Args:
            start: Where the line begins, m, (3,).
            end: Where it ends.
            after: Where the hand goes after that.
            slow: Factor of the time along the line.
        """
        self.to(self.pos, gripper=GRASP_CLOSED_M).to(start).to(end, slow=slow, hold_s=0.1)
        for pos in after:
            self.to(pos)
        return self

"""Joint targets with which one robot's hand follows the paths of another's.

Shapes: N episodes, T = control steps of a path, J = joints, D = driven joints.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from envs.kinematics.batched_inverse import BatchedPathFollower
from envs.kinematics.pose_follower import PoseFollower
from envs.kinematics.waypoints import minimum_jerk
from envs.rotations import conjugate, multiply
from envs.state import State
from envs.tasks.base import Task
from roboverse_learn.data.augmentation.pose import Pose, partly
from roboverse_learn.data.augmentation.recording import HandReader
from roboverse_learn.data.retargeting.hand_path import HandPath

BLEND_S = 0.5
"""Time in which the hand comes from its own start to the path: starts differ by about a centimetre."""


class RetargetedPath(NamedTuple):
    """A path followed by the robot.

    Attributes:
        targets: Targets of the driven joints, (T, D) float32.
        missed_m: Farthest that a pose is missed by.
        missed_rad: Likewise, its orientation.
    """

    targets: np.ndarray
    missed_m: float
    missed_rad: float


class RetargetPlanner:
    """Plans for the robot of a task.

    Args:
        task: The task, with the robot that is to follow.
        at_once: Whether all paths of a call are followed in one batch, on the GPU where there is one.
    """

    def __init__(self, task: Task, *, at_once: bool = False) -> None:
        scenario = task.scenario
        self._robot, self._hz = scenario.robots[0], scenario.physics.control_hz
        self._driven, self._reader = list(self._robot.driven), HandReader(self._robot)
        device = "cuda" if torch.cuda.is_available() else "cpu"
        self._single = None if at_once else PoseFollower(self._robot)
        self._batched = BatchedPathFollower(self._robot, self._hz, device) if at_once else None

    def plan(self, state: State, paths: Sequence[HandPath]) -> list[RetargetedPath]:
        """Returns how the robot follows paths from the states in which its episodes begin, (N,) each."""
        joints = self._reader.starts(state)
        hands = self._reader.hands(joints)
        ways = [
            approached(path, hands.rows(slice(row, row + 1)), round(BLEND_S * self._hz))
            for row, path in enumerate(paths)
        ]
        if self._single is None:
            followed = self._follow_batch(joints, ways)
        else:
            found = [self._single.follow(start, *way) for start, way in zip(joints, ways, strict=True)]
            followed = [(one.targets, one.errors_m.max(), one.errors_rad.max()) for one in found]
        return [self._finished(path, *one) for path, one in zip(paths, followed, strict=True)]

    def _follow_batch(
        self, joints: np.ndarray, ways: Sequence[Pose]
    ) -> list[tuple[np.ndarray, np.floating, np.floating]]:
        """Follows all ways together: targets (T, J), and how far each misses at most, m and rad."""
        assert self._batched is not None
        longest = max(len(way.pos) for way in ways)
        rows = [np.minimum(np.arange(longest), len(way.pos) - 1) for way in ways]
        pos, rot = (
            np.stack([part[index] for part, index in zip(parts, rows, strict=True)])
            for parts in ([way.pos for way in ways], [way.rot for way in ways])
        )
        found = self._batched.follow_poses(joints, pos, rot)
        return [
            (targets[: len(way.pos)], off.max(), turn.max())
            for targets, off, turn, way in zip(*(part.cpu().numpy() for part in found), ways, strict=True)
        ]

    def _finished(
        self, path: HandPath, targets: np.ndarray, missed_m: np.floating, missed_rad: np.floating
    ) -> RetargetedPath:
        """Adds the gripper's targets; a gripper that opens less opens as far as it can."""
        targets = targets.copy()
        targets[:, list(self._robot.fingers)] = self._robot.finger_positions(path.half_gap_m)
        return RetargetedPath(targets[:, self._driven].astype(np.float32), float(missed_m), float(missed_rad))


def approached(path: HandPath, start: Pose, blend_steps: int) -> Pose:
    """Returns the poses of a path (T,) for a hand that starts elsewhere.

    The offset between both starts vanishes with least jerk, before the gripper first acts.

    Args:
        path: The path.
        start: Where the hand starts, in the world, (1,).
        blend_steps: Control steps in which the offset vanishes at most.
    """
    count = max(1, min(blend_steps, path.first_act))
    left = np.zeros(path.num_steps)
    left[:count] = (1.0 - minimum_jerk(count))[: path.num_steps]
    turn = multiply(start.rot[0], conjugate(path.start.rot[0]))
    return Pose(
        path.poses.pos + left[:, None] * (start.pos - path.start.pos),
        multiply(partly(turn, left), path.poses.rot),
    )

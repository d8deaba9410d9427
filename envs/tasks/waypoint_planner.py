"""Planner that turns the waypoints of a task's expert into joint targets, by inverse kinematics."""

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
import torch

from envs.joint_readings import target_readings
from envs.kinematics.batched_inverse import BatchedPathFollower
from envs.kinematics.inverse import PathFollower
from envs.kinematics.waypoints import Waypoint
from envs.scenario import RobotCfg, ScenarioCfg
from envs.state import State

Expert = Callable[[State, np.random.Generator], list[Waypoint]]
"""See :meth:`envs.tasks.base.Task.expert`."""

Follow = Callable[[np.ndarray, Sequence[Sequence[Waypoint]]], list[np.ndarray]]
"""Joint targets of each way, (T, J), from joint positions (N, J)."""


class WaypointPlanner:
    """Follows an expert's waypoints with the first robot of a scenario.

    Args:
        scenario: The scene; actions are targets of its first robot's driven joints.
        expert: Returns waypoints for a state of one row.
    """

    def __init__(self, scenario: ScenarioCfg, expert: Expert) -> None:
        self._expert, self._robot = expert, scenario.robots[0]
        self._driven, self._readings = list(self._robot.driven), target_readings(self._robot)
        self._control_hz = scenario.physics.control_hz
        self._follower = PathFollower(self._robot, self._control_hz)

    def plan(self, state: State, rng: np.random.Generator) -> np.ndarray:
        """Returns actions (T, D) float32, joint targets; see :class:`envs.tasks.planner.Planner`."""
        return self.plan_each(state, [rng])[0]

    def plan_each(self, state: State, rngs: Sequence[np.random.Generator]) -> list[np.ndarray]:
        """Returns the plans of all rows of ``state``; see :class:`envs.tasks.planner.ExactBatchPlanner`."""
        return self._plans(state, rngs, self._follower.targets_of_all)

    def plan_batch(self, state: State, rngs: Sequence[np.random.Generator]) -> list[np.ndarray]:
        """Returns the plans of all rows of ``state``; see :class:`envs.tasks.planner.BatchPlanner`."""
        return self._plans(state, rngs, lambda starts, ways: self._batched.joint_targets(starts, ways).each())

    def _plans(self, state: State, rngs: Sequence[np.random.Generator], follow: Follow) -> list[np.ndarray]:
        ways = [self._expert(state.select([row]), rng) for row, rng in enumerate(rngs)]
        plans = [np.zeros((0, len(self._driven)), np.float32)] * len(ways)
        rows = [row for row, way in enumerate(ways) if way]
        if rows:
            starts = present_targets(state, self._robot)[rows].numpy()
            for row, targets in zip(rows, follow(starts, [ways[row] for row in rows]), strict=True):
                plans[row] = self._readings.read(targets[:, self._driven]).astype(np.float32)
        return plans

    @cached_property
    def _batched(self) -> BatchedPathFollower:
        device = "cuda" if torch.cuda.is_available() else "cpu"
        return BatchedPathFollower(self._robot, self._control_hz, device)


def present_targets(state: State, cfg: RobotCfg) -> torch.Tensor:
    """Returns targets (N, J) of driven joints, which a load keeps them from, and positions of others."""
    robot = state.robots[cfg.name]
    if robot.joint_target is None:
        return robot.joint_pos
    starts = robot.joint_pos.clone()
    starts[:, list(cfg.driven)] = robot.joint_target
    return starts

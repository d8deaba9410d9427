"""Planner for several arms: they move at once, and wait for each other between phases."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from envs.kinematics.batched_inverse import BatchedPathFollower
from envs.kinematics.inverse import PathFollower
from envs.kinematics.waypoints import Waypoint
from envs.scenario import RobotCfg
from envs.state import State
from envs.tasks.waypoint_planner import Follow, present_targets

Phase = Mapping[str, Sequence[Waypoint]]
"""Robots to their waypoints. All begin at once, and the phase is over when the last has arrived: who is early
waits at its last waypoint, and who is absent stays where it is."""

Phases = Callable[[State, np.random.Generator], Sequence[Phase]]
"""See :meth:`envs.tasks.arms.ArmsAtTable.phases`."""


@dataclass(frozen=True, slots=True)
class ArmWay:
    """One arm's part of phases.

    Attributes:
        wait: Control steps for which it stays where it is at first.
        ways: Its waypoints after that; each waits where the arm is early.
    """

    wait: int
    ways: tuple[Waypoint, ...]


def steps_of(ways: Sequence[Waypoint], control_hz: float) -> int:
    """Returns the control steps of waypoints; see :func:`envs.kinematics.waypoints.interpolate`."""
    return sum(max(1, round(way.duration_s * control_hz)) + round(way.hold_s * control_hz) for way in ways)


def scheduled(phases: Sequence[Phase], robots: Sequence[str], control_hz: float) -> dict[str, ArmWay]:
    """Returns every robot's part of phases; all parts have the same number of control steps."""
    waits, ways = dict.fromkeys(robots, 0), {name: list[Waypoint]() for name in robots}
    for phase in phases:
        counts = {name: steps_of(phase.get(name, ()), control_hz) for name in robots}
        for name in robots:
            own = ways[name]
            own += phase.get(name, ())
            early = max(counts.values()) - counts[name]
            if own:
                last = own[-1]
                own[-1] = replace(last, hold_s=(round(last.hold_s * control_hz) + early) / control_hz)
            else:
                waits[name] += early
    return {name: ArmWay(waits[name], tuple(ways[name])) for name in robots}


class ArmsPlanner:
    """Follows the phases of an expert with several robots.

    Args:
        robots: The robots, in the order of an action, which are targets of their driven joints.
        control_hz: Control steps per second.
        phases: Returns phases for a state of one row; none gives up.
    """

    def __init__(self, robots: Sequence[RobotCfg], control_hz: float, phases: Phases) -> None:
        self._robots, self._control_hz, self._phases = robots, control_hz, phases
        self._names = [robot.name for robot in robots]
        self._width = sum(len(robot.driven) for robot in robots)

    def plan(self, state: State, rng: np.random.Generator) -> np.ndarray:
        """Returns targets (T, D) float32 of all driven joints; see :class:`envs.tasks.planner.Planner`."""
        return self.plan_each(state, [rng])[0]

    def plan_each(self, state: State, rngs: Sequence[np.random.Generator]) -> list[np.ndarray]:
        """Returns the plans of all rows of ``state``; see :class:`envs.tasks.planner.ExactBatchPlanner`."""
        return self._plans(state, rngs, [follower.targets_of_all for follower in self._followers])

    def plan_batch(self, state: State, rngs: Sequence[np.random.Generator]) -> list[np.ndarray]:
        """Returns the plans of all rows of ``state``; see :class:`envs.tasks.planner.BatchPlanner`."""
        follow = [
            lambda starts, ways, follower=follower: follower.joint_targets(starts, ways).each()
            for follower in self._batched
        ]
        return self._plans(state, rngs, follow)

    def _plans(
        self, state: State, rngs: Sequence[np.random.Generator], follow: Sequence[Follow]
    ) -> list[np.ndarray]:
        each = [
            scheduled(self._phases(state.select([row]), rng), self._names, self._control_hz)
            for row, rng in enumerate(rngs)
        ]
        plans: list[list[np.ndarray]] = [[] for _ in each]
        for robot, follow_all in zip(self._robots, follow, strict=True):
            starts = present_targets(state, robot).numpy()
            arms = [arms[robot.name] for arms in each]
            moving = [row for row, arm in enumerate(arms) if arm.ways]
            moves: dict[int, np.ndarray] = {}
            if moving:
                found = follow_all(starts[moving], [arms[row].ways for row in moving])
                moves = dict(zip(moving, found, strict=True))
            for row, arm in enumerate(arms):
                moved = [moves[row]] if row in moves else []
                plans[row].append(_after_wait(starts[row], arm.wait, moved, robot))
        return [np.concatenate(parts, axis=1) for parts in plans]

    @cached_property
    def _followers(self) -> list[PathFollower]:
        return [PathFollower(robot, self._control_hz) for robot in self._robots]

    @cached_property
    def _batched(self) -> list[BatchedPathFollower]:
        device = "cuda" if torch.cuda.is_available() else "cpu"
        return [BatchedPathFollower(robot, self._control_hz, device) for robot in self._robots]


def _after_wait(start: np.ndarray, wait: int, moves: list[np.ndarray], robot: RobotCfg) -> np.ndarray:
    """Returns targets (T, D) float32 of driven joints that first stay at ``start`` (J,)."""
    stays = np.tile(start, (wait, 1))
    return np.concatenate([stays, *moves])[:, list(robot.driven)].astype(np.float32)

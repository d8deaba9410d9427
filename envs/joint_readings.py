"""The numbers by which datasets and policies read a robot's joints: the one place where units are converted.

Inside, every position is in rad (m). A robot such as the SO-101 is read in degrees and percent, as LeRobot's
driver reads the real one: recorded states, live observations and actions all pass through here. Positions of
a robot without readings of its own pass as they are, bit-identical.

Numbers are computed in float64, so that a state gives the same reading whether it comes from a recording or
from a simulator in single precision.

Shapes: N states, D joints.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from envs.core.identity_cache import cached_by_identity
from envs.scenario import RobotCfg


class JointReadings:
    """Readings of some of a robot's joints.

    Args:
        robot: The robot.
        columns: Indices of the joints, among all of them.

    Attributes:
        names: Name of each reading, (D,).
        own_units: Whether all are positions in rad (m), which need no conversion.
    """

    def __init__(self, robot: RobotCfg, columns: Sequence[int]) -> None:
        cfgs = [robot.joints[column].reading for column in columns]
        self.names = tuple(robot.reading_names[column] for column in columns)
        self.own_units = all(cfg is None for cfg in cfgs)
        self._scale = np.array([1.0 if cfg is None else cfg.scale for cfg in cfgs])
        self._zero = np.array([0.0 if cfg is None else cfg.zero for cfg in cfgs])

    def read(self, positions: Any) -> Any:
        """Returns the readings of positions (..., D), an array or a tensor; float64 if any unit differs."""
        if self.own_units:
            return positions
        scale, zero, values = self._like(positions)
        return scale * (values - zero)

    def positions(self, readings: Any) -> Any:
        """Returns the positions, rad (m), of readings (..., D); likewise."""
        if self.own_units:
            return readings
        scale, zero, values = self._like(readings)
        return values / scale + zero

    def limits(self, ranges: Sequence[tuple[float, float]]) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Returns the least and the largest readings within ranges of positions, one per joint."""
        if self.own_units:
            return tuple(low for low, _ in ranges), tuple(high for _, high in ranges)
        ends = np.sort(self.read(np.array(ranges).T), axis=0)
        return tuple(ends[0].tolist()), tuple(ends[1].tolist())

    def _like(self, values: Any) -> tuple[Any, Any, Any]:
        """Returns scale, zero and values, in float64 and as what the values are."""
        if not isinstance(values, Tensor):
            return self._scale, self._zero, np.asarray(values, np.float64)
        exact = values.to(torch.float64)
        return torch.as_tensor(self._scale).to(exact), torch.as_tensor(self._zero).to(exact), exact


@cached_by_identity
def joint_readings(robot: RobotCfg) -> JointReadings:
    """Returns the readings of all joints: the order of a robot's state."""
    return _readings(robot, tuple(range(len(robot.joints))))


@cached_by_identity
def target_readings(robot: RobotCfg) -> JointReadings:
    """Returns the readings of the driven joints: the order of joint targets."""
    return _readings(robot, robot.driven)


@lru_cache(maxsize=128)
def _readings(robot: RobotCfg, columns: tuple[int, ...]) -> JointReadings:
    return JointReadings(robot, columns)

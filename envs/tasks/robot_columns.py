"""Columns of a robot's arrays of joints by their role: which are the arm's and which open the gripper."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from envs.core.identity_cache import cached_by_identity
from envs.scenario import RobotCfg


@dataclass(frozen=True, slots=True)
class RobotColumns:
    """Where the joints of a role are.

    Attributes:
        arm: Columns, of all joints, of the arm's.
        arm_targets: Columns of the arm's among the targets, which only driven joints have.
        fingers: Columns, of all joints, of the gripper's.
        finger_targets: Columns of the gripper's among the targets.
        shut: Position of each of the gripper's joints when closed.
        metres: Distance between the fingertips per unit of each of these joints.
        closed_m: Distance between the fingertips when closed, m.
    """

    arm: slice | list[int]
    arm_targets: slice | list[int]
    fingers: tuple[int, ...]
    finger_targets: tuple[int, ...]
    shut: tuple[float, ...]
    metres: tuple[float, ...]
    closed_m: float

    def gap(self, values: Any, columns: Sequence[int]) -> Any:
        """Returns the distance between the fingertips (N,), m, of positions or targets (N, D)."""
        parts = (
            values[:, column] if (shut, metres) == (0.0, 1.0) else (values[:, column] - shut) * metres
            for column, shut, metres in zip(columns, self.shut, self.metres, strict=True)
        )
        total = next(parts)
        for part in parts:
            total = total + part
        return total + self.closed_m if self.closed_m else total


@cached_by_identity
def columns_of(robot: RobotCfg) -> RobotColumns:
    """Returns the columns of a robot's joints by their role."""
    driven, fingers, limits = list(robot.driven), robot.fingers, robot.finger_limits
    share = (robot.opening_m - robot.gripper_closed_m) / max(1, len(fingers))
    return RobotColumns(
        arm=_as_slice(robot.arm),
        arm_targets=_as_slice([driven.index(column) for column in robot.arm]),
        fingers=fingers,
        finger_targets=tuple(driven.index(column) for column in fingers),
        shut=tuple(shut for shut, _ in limits),
        metres=tuple(share / (wide - shut) for shut, wide in limits),
        closed_m=robot.gripper_closed_m,
    )


def _as_slice(columns: Sequence[int]) -> slice | list[int]:
    """Returns neighbouring columns as a slice, which is read without a copy."""
    first = columns[0] if columns else 0
    together = list(columns) == list(range(first, first + len(columns)))
    return slice(first, first + len(columns)) if together else list(columns)

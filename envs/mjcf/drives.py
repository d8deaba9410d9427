"""What the actuators of a robot measure: the position of a joint, or the length of a tendon over several."""

import numpy as np
import torch
from torch import Tensor

from envs.scenario import RobotCfg


class DriveLengths:
    """The lengths of a robot's actuators, from its joints; a speed of theirs from the joints' speeds.

    Shapes: N states, J joints, D actuators, in the order of joint targets.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: RobotCfg) -> None:
        names, driven = robot.joint_names, list(robot.driven)
        self._all = driven == list(range(len(names)))
        self._driven = torch.tensor(driven)
        pulls = [robot.joints[index].pulls for index in driven]
        # The k-th further joint of each tendon, of all tendons at once: rows, columns and coefficients.
        self._further: list[tuple[Tensor, Tensor, Tensor]] = []
        for k in range(max(map(len, pulls), default=0)):
            rows = [row for row, of_row in enumerate(pulls) if len(of_row) > k]
            columns = [names.index(pulls[row][k][0]) for row in rows]
            coefficients = torch.tensor([pulls[row][k][1] for row in rows], dtype=torch.float64)
            self._further.append((torch.tensor(rows), torch.tensor(columns), coefficients))

    def __call__(self, joints: Tensor) -> Tensor:
        """Returns the lengths (N, D) of joints (N, J), rad (m)."""
        if self._all:
            return joints
        if self._driven.device != joints.device:
            self._driven = self._driven.to(joints.device)
            further = [[part.to(joints.device) for part in parts] for parts in self._further]
            self._further = [(rows, columns, weights) for rows, columns, weights in further]
        lengths = joints[:, self._driven]
        for rows, columns, coefficients in self._further:
            lengths[:, rows] += coefficients.to(joints.dtype) * joints[:, columns]
        return lengths


def rest_targets(robot: RobotCfg) -> np.ndarray:
    """Returns the targets at rest of a robot's actuators, (D,): rest lengths, and no torques."""
    rest = torch.tensor([robot.default_qpos], dtype=torch.float64)
    return (DriveLengths(robot)(rest)[0] * torch.from_numpy(holding(robot))).numpy()


def holding(robot: RobotCfg) -> np.ndarray:
    """Returns 1.0 for each actuator whose target is a position and 0.0 where it is a torque, (D,)."""
    return np.array([robot.joints[index].drive == "position" for index in robot.driven], np.float64)

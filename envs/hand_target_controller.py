"""A controller of hand poses in the world, so that one policy moves any arm.

Shapes: N environments, D driven joints, T steps.
"""

from typing import override

import numpy as np
import torch
from torch import Tensor

from envs.hand_pose_controller import HandPoseController
from envs.joint_readings import target_readings
from envs.rotations import to_matrix
from envs.scenario import RobotCfg
from envs.state import EntityState, State

NAMES = ("x", "y", "z", *(f"rotation_{row}{column}" for column in (1, 2) for row in (1, 2, 3)), "gripper")
"""Position of the end effector in the world, m; the first two columns of its rotation matrix, which are
continuous (arXiv:1812.07035); and the share open of the gripper, 0 to 1."""

LIMITS = ((-2.0,) * 3 + (-1.0,) * 6 + (-0.2,), (2.0,) * 3 + (1.0,) * 6 + (1.2,))

_ITERATIONS = 4
"""Steps of inverse kinematics from the present targets: a policy's next pose is a few cm away."""


class HandTargetController(HandPoseController):
    """An action is the pose of the hand in the world, and how far the gripper is open; see :data:`NAMES`.

    Args:
        robot: A robot with position actuators, gravity compensation and a gripper.
    """

    def __init__(self, robot: RobotCfg) -> None:
        super().__init__(robot)
        self.names = NAMES
        self.low, self.high = (np.array(limits, np.float32) for limits in LIMITS)
        self.held = ("state",) * 9 + ("last",)

    @override
    def moved_targets(self, joints: Tensor, targets: Tensor, actions: np.ndarray | Tensor) -> Tensor:
        ik = self._kinematics(joints.device)
        given = torch.as_tensor(actions, device=joints.device).double()
        pos, rot = given[:, :3], _rotations(given[:, 3:9])
        posture = self._targeted(joints, targets)
        start = q = posture[:, ik.chain.columns]
        for _ in range(_ITERATIONS):
            q = q + ik.change(q, ik.chain(q), pos, rot)
        way = q - start
        posture[:, ik.chain.columns] = start + way * self._share(start - joints[:, ik.chain.columns], way)
        posture[:, self._fingers] = self._closed + self._stroke * given[:, 9:].clamp(0.0, 1.0)
        return posture[:, self._driven].to(joints.dtype)

    @override
    def hold(self, state: State) -> np.ndarray:
        robot = state.robots[self._robot.name]
        assert robot.joint_target is not None, "a simulator gives every robot's targets"
        return self._actions(robot.joint_pos, robot.joint_target)

    @override
    def of_joint_targets(self, targets: np.ndarray) -> np.ndarray:
        if not len(targets):
            return np.zeros((0, len(self.names)), np.float32)
        driven = torch.from_numpy(target_readings(self._robot).positions(targets).astype(np.float64))
        posture = torch.tensor([self._robot.default_qpos] * len(driven), dtype=torch.float64)
        return self._actions(posture, driven)

    @override
    def as_task_actions(self, state: State, actions: np.ndarray) -> np.ndarray:
        return actions

    def _actions(self, joints: Tensor, targets: Tensor) -> np.ndarray:
        """Returns the actions (N, 10) float32 that mean targets (N, D) of driven joints."""
        pos, rot = self.target_pose(joints, targets)
        finger = targets[:, self._driven.index(self._fingers[0])].to(pos)
        share = (finger - self._closed[0].to(pos)) / self._stroke[0].to(pos)
        return torch.cat([pos, _columns(rot), share[:, None]], 1).cpu().numpy().astype(np.float32)


def hand_state(cfg: RobotCfg, robot: EntityState) -> Tensor:
    """Returns the pose of a robot's hand and the share open of its gripper (N, 10); see :data:`NAMES`."""
    assert robot.ee_pos is not None and robot.ee_rot is not None, "a simulator gives every robot's hand"
    closed, opened = (cfg.gripper_range or [cfg.joints[index].range for index in cfg.fingers])[0]
    share = (robot.joint_pos[:, cfg.fingers[0]] - closed) / (opened - closed)
    pos = torch.as_tensor(robot.ee_pos)
    rot = to_matrix(torch.as_tensor(robot.ee_rot))
    return torch.cat([pos, _columns(rot), torch.as_tensor(share)[:, None].to(pos)], 1)


def _columns(rot: Tensor) -> Tensor:
    """Returns the first two columns of rotation matrices (N, 3, 3), one after the other, (N, 6)."""
    return rot[:, :, :2].transpose(1, 2).flatten(1)


def _rotations(columns: Tensor) -> Tensor:
    """Returns the rotation matrices (N, 3, 3) nearest to two columns each (N, 6), by Gram and Schmidt."""
    first = torch.nn.functional.normalize(columns[:, :3], dim=1)
    second = columns[:, 3:] - (first * columns[:, 3:]).sum(1, keepdim=True) * first
    second = torch.nn.functional.normalize(second, dim=1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=2)

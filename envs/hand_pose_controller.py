"""A controller of end-effector deltas in six degrees of freedom, for a person who steers the hand."""

from typing import override

import numpy as np
import torch
from torch import Tensor

from envs.controllers import HandDeltaController
from envs.joint_readings import target_readings
from envs.kinematics.forward import from_rotation_vector
from envs.scenario import RobotCfg
from envs.simulators.base import EnvIds, Handler
from envs.state import State

_ITERATIONS = 2
"""Steps of inverse kinematics: the hand follows 5 cm and 0.2 rad within 0.5 mm, so that deltas add up."""


class HandPoseController(HandDeltaController):
    """End-effector deltas in all six degrees of freedom, for a person who steers the hand.

    The entries are x, y, z, roll, pitch, yaw, and gripper if there is one; translations and the rotation
    vector are about the world's axes. An entry of 1 moves the hand's *target* by ``delta_m`` or turns it by
    ``delta_rad``. Deltas are from the target and not from where the hand is, as in ManiSkill 3's
    ``pd_ee_target_delta_pose``, so an arm that sags under a load does not creep. An action whose first six
    entries are 0 leaves the arm's targets as they are. The gripper is that of :class:`HandDeltaController`.

    Args:
        robot: A robot with position actuators and gravity compensation.
        delta_m: Translation of the hand's target at an action of 1.
        delta_rad: Rotation of the hand's target at an action of 1.
        lead_rad: Largest distance of a joint's target from the joint (rad, or m of a slide), which bounds how
            hard a blocked hand presses, and how far it must be steered back.
    """

    def __init__(
        self, robot: RobotCfg, delta_m: float = 0.05, delta_rad: float = 0.2, lead_rad: float = 0.35
    ) -> None:
        super().__init__(robot, delta_m, delta_rad)
        self.names = ("x", "y", "z", "roll", "pitch", "yaw", *self.names[4:])
        self.low, self.high = -np.ones(len(self.names), np.float32), np.ones(len(self.names), np.float32)
        self.held = ("zero",) * 6 + ("last",) * len(self.names[6:])
        self.delta_m, self.delta_rad, self._lead_rad = delta_m, delta_rad, lead_rad

    @override
    def joint_targets(
        self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None
    ) -> dict[str, np.ndarray | Tensor]:
        name = self._robot.name
        joints, targets = handler.get_joint_positions(name, env_ids), handler.get_joint_targets(name, env_ids)
        return {name: self.moved_targets(joints, targets, actions)}

    @override
    def as_task_actions(self, state: State, actions: np.ndarray) -> np.ndarray:
        robot = state.robots[self._robot.name]
        assert robot.joint_target is not None, "a simulator gives every robot's targets"
        targets = self.moved_targets(robot.joint_pos, robot.joint_target, actions).cpu().numpy()
        return target_readings(self._robot).read(targets)

    @override
    def targets(self, joints: Tensor, actions: np.ndarray | Tensor) -> Tensor:
        return self.moved_targets(joints, joints[:, self._driven], actions)

    def moved_targets(self, joints: Tensor, targets: Tensor, actions: np.ndarray | Tensor) -> Tensor:
        """Returns the next targets (n, D) of the D driven joints.

        Args:
            joints: Positions of all joints, rad and m, (n, J).
            targets: Present targets of the driven joints, (n, D).
            actions: (n, A).
        """
        ik = self._kinematics(joints.device)
        given = torch.as_tensor(actions, device=joints.device).double().clamp(-1.0, 1.0)
        posture = self._targeted(joints, targets)
        start = q = posture[:, ik.chain.columns]
        now = ik.chain(q)
        pos = now.pos + self.delta_m * given[:, :3]
        rot = from_rotation_vector(self.delta_rad * given[:, 3:6]) @ now.rot
        for step in range(_ITERATIONS):
            q = q + ik.change(q, ik.chain(q) if step else now, pos, rot)
        way = (q - start) * given[:, :6].ne(0.0).any(1, keepdim=True)
        posture[:, ik.chain.columns] = start + way * self._share(start - joints[:, ik.chain.columns], way)
        if self._fingers:
            posture[:, self._fingers] = self._finger_targets(given[:, 6:7])
        return posture[:, self._driven].to(joints.dtype)

    def _share(self, lead: Tensor, way: Tensor) -> Tensor:
        """Returns the share (n, 1) of a way (n, K) that may be taken; all joints together keep its direction.

        Args:
            lead: How far targets are from their joints already, (n, K).
            way: How far they would be moved.
        """
        room = (self._lead_rad - lead * way.sign()).clamp(min=0.0)
        return (room / way.abs().clamp(min=1e-9)).amin(1, keepdim=True).clamp(max=1.0)

    def target_pose(self, joints: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
        """Returns where the targets put the hand in the world: position (n, 3), m, and orientation (n, 3, 3).

        Args:
            joints: Positions of all joints, rad and m, (n, J).
            targets: Targets of the driven joints, (n, D).
        """
        chain = self._kinematics(joints.device).chain
        poses = chain(self._targeted(joints, targets)[:, chain.columns])
        return poses.pos, poses.rot

    def _targeted(self, joints: Tensor, targets: Tensor) -> Tensor:
        """Returns the posture (n, J) float64 in which every driven joint is at its target."""
        posture = joints.to(torch.float64, copy=True)
        posture[:, self._driven] = targets.to(posture)
        return posture

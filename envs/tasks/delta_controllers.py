"""ManiSkill 3's delta actions of an arm: of its joints, and of the pose of its hand.

``mani_skill/agents/robots/panda/panda.py``, ``agents/controllers/`` (Apache-2.0). A delta is from where the
arm *is*, and the target jumps there at once: at ManiSkill's lag of 0.1 s, which is also that of our arms, and
20 Hz, an arm goes two fifths of the way. The gripper is absolute: 1 opens it, -0.6 and less close it.

Shapes: N environments, J joints, D driven joints, A entries of an action.
"""

from typing import override

import numpy as np
import torch
from torch import Tensor

from envs.array_ops import Array
from envs.controllers import HandDeltaController
from envs.kinematics.forward import from_rotation_vector, rotation_vector
from envs.rotations import to_matrix
from envs.scenario import RobotCfg
from envs.simulators.base import EnvIds, Handler
from envs.state import State

DELTA_RAD, DELTA_M = 0.1, 0.1
"""Turn of a joint or of the hand, and way of the hand, at an entry of 1."""

_ITERATIONS = 4
"""Steps of inverse kinematics: a pose 10 cm away is met within a tenth of a millimetre."""


class _DeltaController(HandDeltaController):
    """Deltas from where the arm is, whose target is set at the start of a step.

    Args:
        robot: A robot with position actuators.
        names: Entries of an action but for the gripper's.
        control_hz: Actions per second.
    """

    def __init__(self, robot: RobotCfg, names: tuple[str, ...], control_hz: float) -> None:
        super().__init__(robot, DELTA_M, DELTA_RAD)
        self.names = (*names, "gripper")
        self.low, self.high = -np.ones(len(self.names), np.float32), np.ones(len(self.names), np.float32)
        self.held = ("zero",) * len(names) + ("last",)
        self._arm, self._arm_targets = list(robot.arm), [self._driven.index(i) for i in robot.arm]
        lag_s = torch.tensor(
            [robot.joints[i].kd / robot.joints[i].kp for i in robot.arm], dtype=torch.float64
        )
        self._share = 1.0 - torch.exp(-1.0 / (control_hz * lag_s))

    @override
    def advance(
        self, handler: Handler, actions: np.ndarray | Tensor, num_steps: int, env_ids: EnvIds = None
    ) -> None:
        self.apply(handler, actions, env_ids)
        handler.step(num_steps, env_ids)

    @override
    def as_task_actions(self, state: State, actions: np.ndarray) -> np.ndarray:
        return actions

    @override
    def targets(self, joints: Tensor, actions: np.ndarray | Tensor) -> Tensor:
        self._kinematics(joints.device)
        given = torch.as_tensor(actions, device=joints.device).double().clamp(-1.0, 1.0)
        targets = joints.to(torch.float64, copy=True)
        targets[:, self._arm] = self._arm_at(targets, given[:, :-1])
        targets[:, self._fingers] = self._finger_targets(given[:, -1:])
        return targets[:, self._driven].to(joints.dtype)

    def towards(self, state: State, targets: Array) -> np.ndarray:
        """Returns actions (N, A) float32 that bring the arm nearest to joint targets within one step.

        Args:
            state: Where it is.
            targets: Targets of the driven joints (N, D), rad and m.
        """
        joints = torch.as_tensor(state.robots[self._robot.name].joint_pos).double().cpu()
        self._kinematics(joints.device)
        wanted = torch.as_tensor(targets).double()
        way, gripper = self._way(joints, self._posture(wanted)), self.gripper_entry(wanted)[:, None]
        longest = way.abs().amax(1, keepdim=True).clamp(min=1.0)  # a way that is cut keeps its direction
        return torch.cat([way / longest, gripper], 1).clamp(-1.0, 1.0).numpy().astype(np.float32)

    def lengths(self, targets: Array) -> np.ndarray:
        """Returns the largest entry (T - 1,) by which a step goes from each row of (T, D) to the next."""
        postures = self._posture(torch.as_tensor(targets).double())
        self._kinematics(postures.device)
        return self._way(postures[:-1], postures[1:]).abs().amax(1).numpy()

    def _posture(self, targets: Tensor) -> Tensor:
        """Returns postures (N, J) whose arm is at the targets (N, D)."""
        postures = torch.tensor([self._robot.default_qpos] * len(targets), dtype=torch.float64)
        postures[:, self._arm] = targets[:, self._arm_targets]
        return postures

    def _arm_at(self, joints: Tensor, given: Tensor) -> Tensor:
        """Returns targets (N, K) of the arm's joints for entries but for the gripper's."""
        raise NotImplementedError

    def _way(self, joints: Tensor, wanted: Tensor) -> Tensor:
        """Returns the entries, not yet clipped, that bring postures (N, J) to others in a step."""
        raise NotImplementedError


class JointDeltaController(_DeltaController):
    """``pd_joint_delta_pos``: an entry of 1 turns the target of a joint 0.1 rad from where the joint is."""

    def __init__(self, robot: RobotCfg, control_hz: float) -> None:
        super().__init__(robot, tuple(robot.joints[index].name for index in robot.arm), control_hz)

    @override
    def _arm_at(self, joints: Tensor, given: Tensor) -> Tensor:
        return joints[:, self._arm] + DELTA_RAD * given

    @override
    def _way(self, joints: Tensor, wanted: Tensor) -> Tensor:
        return (wanted - joints)[:, self._arm] / (DELTA_RAD * self._share)


class PoseDeltaController(_DeltaController):
    """``pd_ee_delta_pose``: x, y, z, and three Euler angles of a turn, about the axes of the robot's base.

    An entry of 1 moves the target 0.1 m from where the hand is. Turns are as in ManiSkill: together no longer
    than 1, *minus* 0.1 rad at 1, and turns about x, y and z in the order of ``R_x R_y R_z``. The hand turns
    about our end effector, 7 mm nearer to it than ManiSkill's.
    """

    def __init__(self, robot: RobotCfg, control_hz: float) -> None:
        super().__init__(robot, ("x", "y", "z", "roll", "pitch", "yaw"), control_hz)
        self._base = torch.from_numpy(to_matrix(np.array(robot.rot, np.float64)))

    @override
    def _arm_at(self, joints: Tensor, given: Tensor) -> Tensor:
        ik = self._kinematics(joints.device)
        base = self._base.to(joints)
        q = joints[:, ik.chain.columns]
        now = ik.chain(q)
        turn = given[:, 3:] / given[:, 3:].norm(dim=1, keepdim=True).clamp(min=1.0)
        pos = now.pos + DELTA_M * given[:, :3] @ base.T
        rot = base @ _of_euler(-DELTA_RAD * turn) @ base.T @ now.rot
        for _ in range(_ITERATIONS):
            q = q + ik.change(q, ik.chain(q), pos, rot)
        moved = joints.clone()
        moved[:, ik.chain.columns] = q
        return moved[:, self._arm]

    @override
    def _way(self, joints: Tensor, wanted: Tensor) -> Tensor:
        chain = self._kinematics(joints.device).chain
        now, then = chain(joints[:, chain.columns]), chain(wanted[:, chain.columns])
        share = self._share.mean()
        moved = (then.pos - now.pos) @ self._base / (DELTA_M * share)
        vector = rotation_vector(self._base.T @ then.rot @ now.rot.transpose(1, 2) @ self._base) / share
        # Of a turn that is cut, no longer than an entry of 1, Euler angles are as good as proportional.
        longest = vector.norm(dim=1, keepdim=True).clamp(min=DELTA_RAD)
        euler = _euler_of(from_rotation_vector(vector / longest * DELTA_RAD)) * longest / DELTA_RAD
        return torch.cat([moved, -euler / DELTA_RAD], 1)


def _of_euler(angles: Tensor) -> Tensor:
    """Returns ``R_x R_y R_z`` (N, 3, 3) of angles (N, 3), rad."""
    x, y, z = (from_rotation_vector(angles * axis) for axis in torch.eye(3).to(angles))
    return x @ y @ z


def _euler_of(rot: Tensor) -> Tensor:
    """Inverts :func:`_of_euler` of turns below a quarter."""
    y = torch.asin(rot[:, 0, 2].clamp(-1.0, 1.0))
    return torch.stack(
        [torch.atan2(-rot[:, 1, 2], rot[:, 2, 2]), y, torch.atan2(-rot[:, 0, 1], rot[:, 0, 0])], 1
    )

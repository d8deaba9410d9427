"""Controllers: map actions to joint targets."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Literal, override

import numpy as np
import torch
from torch import Tensor

from envs.array_ops import Array
from envs.joint_readings import target_readings
from envs.kinematics.batched_inverse import BatchedInverseKinematics
from envs.rotations import from_yaw, to_matrix
from envs.scenario import Quat, RobotCfg, Vec3
from envs.simulators.base import EnvIds, Handler
from envs.state import State

Held = Literal["state", "zero", "last"]
"""An entry of an action that holds still: the present reading of that name, 0, or the last action's."""


class Controller(ABC):
    """Applies actions.

    Attributes:
        names: What each entry of an action is, A of them.
        low: Least value of each entry, (A,) float32.
        high: Largest value of each entry, (A,) float32.
        held: What each entry is in an action that holds still; empty where it follows from nothing that a
            policy observes.
    """

    names: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    held: tuple[Held, ...] = ()

    @abstractmethod
    def apply(self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None) -> None:
        """Sets the simulator's targets from the actions (n, A) of the environments ``env_ids``."""

    def advance(
        self, handler: Handler, actions: np.ndarray | Tensor, num_steps: int, env_ids: EnvIds = None
    ) -> None:
        """Applies the actions and advances the simulator by one control step, ``num_steps`` physics steps."""
        self.apply(handler, actions, env_ids)
        handler.step(num_steps, env_ids)

    def begin(self, env_ids: Array) -> None:  # noqa: B027 (most remember nothing)
        """Resets what it keeps of the former episodes of some environments, where new ones start."""

    @abstractmethod
    def hold(self, state: State) -> np.ndarray:
        """Returns actions (N, A) that keep the robot where it is in ``state``."""

    def of_joint_targets(self, targets: np.ndarray) -> np.ndarray:
        """Returns the actions (T, A) that a demonstrator's plan means.

        Args:
            targets: Joint targets in the robot's units, (T, D), or what else the task's planner gives, which
                are actions already.
        """
        return targets

    def as_task_actions(self, state: State, actions: np.ndarray) -> np.ndarray:
        """Converts actions (N, A) to actions of the task's own controller with the same effect.

        Args:
            state: States in which the actions are taken.
            actions: Actions of this controller; it is the task's ``rl_controller``.
        """
        del state
        return actions


class TargetController(Controller):
    """A controller of position targets, which move evenly from one control step's end to the next one's.

    A target that jumps shakes the hand, and a grasped cube slips twice as far.
    """

    @abstractmethod
    def joint_targets(
        self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None
    ) -> dict[str, np.ndarray | Tensor]:
        """Returns robots to the targets (n, J) of their driven joints at the end of a step."""

    @override
    def apply(self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None) -> None:
        handler.set_joint_targets(self.joint_targets(handler, actions, env_ids), env_ids)

    @override
    def advance(
        self, handler: Handler, actions: np.ndarray | Tensor, num_steps: int, env_ids: EnvIds = None
    ) -> None:
        handler.step_towards(self.joint_targets(handler, actions, env_ids), num_steps, env_ids)


class JoinedController(TargetController):
    """Controllers of several robots as one: an action is theirs, one after the other.

    Args:
        parts: Robots to their controllers, in the order of an action; entries are called
            ``<robot>/<name>``.
    """

    def __init__(self, parts: Mapping[str, TargetController]) -> None:
        self.names = tuple(f"{robot}/{name}" for robot, part in parts.items() for name in part.names)
        self.low = np.concatenate([part.low for part in parts.values()])
        self.high = np.concatenate([part.high for part in parts.values()])
        if all(part.held for part in parts.values()):
            self.held = tuple(held for part in parts.values() for held in part.held)
        ends = np.cumsum([len(part.names) for part in parts.values()]).tolist()
        columns = [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]
        self._parts = list(zip(parts.values(), columns, strict=True))

    @override
    def joint_targets(
        self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None
    ) -> dict[str, np.ndarray | Tensor]:
        targets: dict[str, np.ndarray | Tensor] = {}
        for part, columns in self._parts:
            targets |= part.joint_targets(handler, actions[:, columns], env_ids)
        return targets

    @override
    def begin(self, env_ids: Array) -> None:
        for part, _ in self._parts:
            part.begin(env_ids)

    @override
    def hold(self, state: State) -> np.ndarray:
        return np.concatenate([part.hold(state) for part, _ in self._parts], axis=1)

    @override
    def as_task_actions(self, state: State, actions: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [part.as_task_actions(state, actions[:, columns]) for part, columns in self._parts], axis=1
        )


class JointPositionController(TargetController):
    """An action is the position target of every driven joint of one robot at the end of the step.

    It is in rad and m, or in the robot's own units; see :mod:`envs.joint_readings`.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: RobotCfg) -> None:
        joints = [robot.joints[index] for index in robot.driven]
        self._readings = target_readings(robot)
        self.names = self._readings.names
        limits = self._readings.limits([joint.range for joint in joints])
        self.low, self.high = (np.array(ends, np.float32) for ends in limits)
        # A finger that squeezes is not where its target is, which would let go of what it holds.
        if all(joint.drive == "position" for joint in joints):
            self.held = tuple("last" if joint.name in robot.gripper_joints else "state" for joint in joints)
        self._robot, self._driven = robot.name, list(robot.driven)

    @override
    def joint_targets(
        self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None
    ) -> dict[str, np.ndarray | Tensor]:
        return {self._robot: self._readings.positions(actions)}

    @override
    def hold(self, state: State) -> np.ndarray:
        return self._readings.read(state.robots[self._robot].joint_pos[:, self._driven].cpu().numpy())


_SQUEEZE = 0.25
"""Distance of the closing target beyond closed, per stroke: 1 cm of 4, as in ManiSkill 3's Panda, so that
exploration noise does not open a gripper that holds something."""


class HandDeltaController(TargetController):
    """End-effector deltas: an action translates the hand, turns it about the vertical, and opens the gripper.

    The entries are x, y, z, yaw, and gripper if there is one. An entry of 1 puts the hand's target
    ``delta_m`` (``delta_rad``) from the present pose of the hand; any other tilt from the rest posture is
    corrected. The gripper is absolute: -0.6 and less close it, 1 opens it. Entries are clipped to [-1, 1].
    This is ManiSkill 3's ``pd_ee_delta_pos`` and a yaw (``mani_skill/agents/robots/panda/panda.py``,
    Apache-2.0). One step of inverse kinematics gives the joint targets.

    Args:
        robot: A robot with position actuators and gravity compensation.
        delta_m: Translation of the hand's target at an action of 1.
        delta_rad: Rotation of the hand's target at an action of 1.
    """

    def __init__(self, robot: RobotCfg, delta_m: float = 0.05, delta_rad: float = 0.2) -> None:
        self.names = ("x", "y", "z", "yaw", *(["gripper"] if robot.gripper_joints else []))
        self.low, self.high = -np.ones(len(self.names), np.float32), np.ones(len(self.names), np.float32)
        self.held = ("zero",) * 4 + ("last",) * len(self.names[4:])
        self._robot, self._delta_m, self._delta_rad = robot, delta_m, delta_rad
        self._driven = list(robot.driven)
        self._fingers = list(robot.fingers)
        fingers = [robot.joints[index] for index in self._fingers]
        limits = robot.gripper_range or [joint.target_range or joint.range for joint in fingers]
        self._closed = torch.tensor([low for low, _ in limits])
        self._stroke = torch.tensor([high - low for low, high in limits])
        self._ik: BatchedInverseKinematics | None = None

    @override
    def joint_targets(
        self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None
    ) -> dict[str, np.ndarray | Tensor]:
        name = self._robot.name
        return {name: self.targets(handler.get_joint_positions(name, env_ids), actions)}

    @override
    def as_task_actions(self, state: State, actions: np.ndarray) -> np.ndarray:
        targets = self.targets(state.robots[self._robot.name].joint_pos, actions).cpu().numpy()
        return target_readings(self._robot).read(targets)

    def targets(self, joints: Tensor, actions: np.ndarray | Tensor) -> Tensor:
        """Returns the targets of the driven joints for actions.

        Args:
            joints: Positions of all joints, rad and m, (n, J).
            actions: (n, A).

        Returns:
            Targets of the driven joints, of the type of ``joints``.
        """
        ik = self._kinematics(joints.device)
        given = torch.as_tensor(actions, device=joints.device).double().clamp(-1.0, 1.0)
        targets = joints.to(torch.float64, copy=True)
        q = targets[:, ik.chain.columns]
        now = ik.chain(q)
        yaw = _yaw(now.rot @ ik.upright.T) + self._delta_rad * given[:, 3]
        pos = now.pos + self._delta_m * given[:, :3]
        rot = to_matrix(from_yaw(yaw)) @ ik.upright
        targets[:, ik.chain.columns] = q + ik.change(q, now, pos, rot)
        if self._fingers:
            targets[:, self._fingers] = self._finger_targets(given[:, 4:5])
        return targets[:, self._driven].to(joints.dtype)

    def _finger_targets(self, gripper: Tensor) -> Tensor:
        """Returns the targets of the fingers (n, F) for entries of the gripper (n, 1) in [-1, 1]."""
        opening = (1.0 + _SQUEEZE) * (gripper + 1.0) / 2 - _SQUEEZE
        return self._closed + self._stroke * opening.clamp(min=0.0)

    def _kinematics(self, device: torch.device) -> BatchedInverseKinematics:
        """Returns the robot's kinematics on a device; its first use there compiles the robot's model."""
        if self._ik is None or self._ik.rest.device != device:
            self._ik = BatchedInverseKinematics(self._robot, device)
            self._closed, self._stroke = self._closed.to(self._ik.rest), self._stroke.to(self._ik.rest)
        return self._ik

    @override
    def hold(self, state: State) -> np.ndarray:
        target = state.robots[self._robot.name].joint_target
        assert target is not None, "a simulator gives every robot's targets"
        still = torch.zeros((len(target), len(self.names)), dtype=target.dtype)
        if self._fingers:
            still[:, -1] = self.gripper_entry(target.cpu())
        return still.numpy()

    def gripper_entry(self, targets: Tensor) -> Tensor:
        """Returns the entries (n,) that give the gripper the targets that it has in ``targets`` (n, D)."""
        finger = targets[:, self._driven.index(self._fingers[0])]
        opening = (finger - self._closed[0].to(finger)) / self._stroke[0].to(finger)
        return 2.0 * (opening + _SQUEEZE) / (1.0 + _SQUEEZE) - 1.0


def _yaw(rot: Tensor) -> Tensor:
    """Returns the rotation about z (N,) that is nearest to rotation matrices (N, 3, 3), rad."""
    return torch.atan2(rot[:, 1, 0] - rot[:, 0, 1], rot[:, 0, 0] + rot[:, 1, 1])


class NormalizedPositionController(Controller):
    """An action is the target of every driven joint of one robot, a position or a torque, within its range.

    An entry of -1 is the least target of the joint's actuator, 1 the largest; entries are clipped.
    This is HumanoidBench's control (``tasks.py``, ``unnormalize_action``).

    Args:
        robot: The robot.
    """

    def __init__(self, robot: RobotCfg) -> None:
        joints = [robot.joints[index] for index in robot.driven]
        self.names = tuple(joint.name for joint in joints)
        self.low, self.high = -np.ones(len(joints), np.float32), np.ones(len(joints), np.float32)
        if all(joint.drive == "position" for joint in joints):
            self.held = ("last",) * len(joints)
        limits = torch.tensor([joint.target_range or joint.range for joint in joints], dtype=torch.float64)
        self._robot, self._middle, self._half = robot.name, limits.mean(1), (limits[:, 1] - limits[:, 0]) / 2

    @override
    def apply(self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None) -> None:
        given = torch.as_tensor(actions, device=handler.device).to(handler.dtype).clamp(-1.0, 1.0)
        self._middle, self._half = self._middle.to(given), self._half.to(given)
        handler.set_joint_targets({self._robot: self._middle + self._half * given}, env_ids)

    @override
    def hold(self, state: State) -> np.ndarray:
        target = state.robots[self._robot].joint_target
        assert target is not None, "a simulator gives every robot's targets"
        middle, half = self._middle.to(target), self._half.to(target)
        return ((target - middle) / half).cpu().numpy()


class OffsetPositionController(Controller):
    """An action offsets the position targets of an arm's joints from their rest; its fingers stay at rest.

    This is Isaac Lab's ``JointPositionActionCfg`` with ``use_default_offset``, except for the bounds: entries
    are clipped to [-1, 1].

    Args:
        robot: A robot with position actuators.
        scale_rad: Distance from the rest position at an action of 1, rad.
    """

    def __init__(self, robot: RobotCfg, scale_rad: float) -> None:
        self._arm = [i for i, joint in enumerate(robot.joints) if joint.name not in robot.gripper_joints]
        self.names = tuple(robot.joints[index].name for index in self._arm)
        self.low, self.high = -np.ones(len(self._arm), np.float32), np.ones(len(self._arm), np.float32)
        self.held = ("last",) * len(self._arm)
        self._robot, self._scale = robot.name, scale_rad
        self._rest = torch.tensor(robot.default_qpos, dtype=torch.float64)

    @override
    def apply(self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None) -> None:
        given = torch.as_tensor(actions, device=handler.device).to(handler.dtype).clamp(-1.0, 1.0)
        self._rest = self._rest.to(given)
        targets = self._rest.repeat(len(given), 1)
        targets[:, self._arm] += self._scale * given
        handler.set_joint_targets({self._robot: targets}, env_ids)

    @override
    def hold(self, state: State) -> np.ndarray:
        target = state.robots[self._robot].joint_target
        assert target is not None, "a simulator gives every robot's targets"
        return ((target - self._rest.to(target))[:, self._arm] / self._scale).cpu().numpy()


class PulledHandController(Controller):
    """An action moves the mocap target of a robot's hand, and presses the fingers: x, y, z, gripper.

    This is Meta-World's control (``sawyer_xyz_env.py``, ``set_xyz_action``). Entries are clipped to [-1, 1].

    Args:
        robot: A robot whose driven joints are two fingers that close towards each other along one axis.
        target: Name of the object that pulls the hand.
        low: Least position of the target, m, (3,).
        high: Largest position of the target, m, (3,).
        step_m: Translation of the target at an action of 1.
        rot: Orientation of the target, wxyz.
    """

    def __init__(
        self, robot: RobotCfg, target: str, *, low: Vec3, high: Vec3, step_m: float, rot: Quat
    ) -> None:
        self.names = ("x", "y", "z", "gripper")
        self.low, self.high = -np.ones(4, np.float32), np.ones(4, np.float32)
        self.held = ("zero", "zero", "zero", "last")
        self._robot, self._target, self._step_m = robot.name, target, step_m
        self._bounds = np.array([low, high])
        self._rot = torch.tensor(rot, dtype=torch.float64)

    @override
    def apply(self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None) -> None:
        actions = np.clip(np.asarray(torch.as_tensor(actions).cpu()), -1.0, 1.0)
        present = handler.get_states(env_ids).objects[self._target].pos
        moved = present.cpu().numpy() + actions[:, :3] * self._step_m
        pos = torch.from_numpy(np.clip(moved, *self._bounds))
        handler.set_poses({self._target: (pos, self._rot.expand(len(pos), 4))}, env_ids)
        effort = actions[:, 3:]
        handler.set_joint_targets({self._robot: np.concatenate([effort, -effort], axis=1)}, env_ids)

    @override
    def hold(self, state: State) -> np.ndarray:
        target = state.robots[self._robot].joint_target
        assert target is not None, "a simulator gives every robot's targets"
        return np.pad(target[:, :1].cpu().numpy(), ((0, 0), (3, 0)))

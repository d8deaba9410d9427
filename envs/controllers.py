"""What an action means: how a row of numbers becomes something a simulator is told."""

from abc import ABC, abstractmethod
from typing import override

import numpy as np
import torch
from torch import Tensor

from envs.handlers.base import EnvIds, Handler
from envs.scenario import Quat, RobotCfg, Vec3
from envs.state import State


class Controller(ABC):
    """Applies actions.

    Attributes:
        names: What each entry of an action is, A of them.
        low: Least value of each entry, (A,) float32.
        high: Largest value of each entry, (A,) float32.
    """

    names: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray

    @abstractmethod
    def apply(self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None) -> None:
        """Tells the simulator what the actions (n, A) of the environments ``env_ids`` mean."""

    def advance(
        self, handler: Handler, actions: np.ndarray | Tensor, num_steps: int, env_ids: EnvIds = None
    ) -> None:
        """Applies the actions and advances the simulator by one control step, ``num_steps`` physics steps."""
        self.apply(handler, actions, env_ids)
        handler.step(num_steps, env_ids)

    @abstractmethod
    def hold(self, state: State) -> np.ndarray:
        """Returns actions (N, A) that keep the robot where it is in ``state``."""

    def as_task_actions(self, state: State, actions: np.ndarray) -> np.ndarray:
        """Returns what a task's own controller has to be told for these actions (N, A) to happen.

        Args:
            state: States in which the actions are taken.
            actions: Actions of this controller; it is the task's ``rl_controller``.
        """
        del state
        return actions


class JointPositionController(Controller):
    """An action is where the position target of every joint of one robot is when the step ends, rad and m.

    It moves there evenly. A target that jumps shakes the hand, and a cube in it slides twice as far.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: RobotCfg) -> None:
        self.names = robot.joint_names
        self.low, self.high = np.array([joint.range for joint in robot.joints], np.float32).T
        self._robot = robot.name

    @override
    def apply(self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None) -> None:
        handler.set_joint_targets({self._robot: actions}, env_ids)

    @override
    def advance(
        self, handler: Handler, actions: np.ndarray | Tensor, num_steps: int, env_ids: EnvIds = None
    ) -> None:
        handler.step_towards({self._robot: actions}, num_steps, env_ids)

    @override
    def hold(self, state: State) -> np.ndarray:
        return state.robots[self._robot].joint_pos.cpu().numpy()


class JointDeltaController(Controller):
    """An action puts the targets of an arm's joints near the joints, and sets the opening of its gripper.

    This is ManiSkill 3's ``pd_joint_delta_pos`` (``mani_skill/agents/robots/panda/panda.py``, Apache-2.0): an
    entry of 1 puts a target ``delta_rad`` from where its joint is; the last entry is absolute, -1 closes and
    1 opens. Every entry lies in [-1, 1]; what lies beyond is clipped, and so are targets.

    Deltas from the last target, ManiSkill's ``pd_joint_target_delta_pos``, wind up: an arm that presses onto
    the table goes on pressing for as many steps as its targets need to come back.

    Args:
        robot: A robot with position actuators, its gravity compensated: it stays where it is at rest.
        delta_rad: Distance of a target from its joint at an action of 1, rad (m for a slide joint).
    """

    def __init__(self, robot: RobotCfg, delta_rad: float = 0.1) -> None:
        driven = [robot.joints[index] for index in robot.driven]
        fingers = [index for index, joint in enumerate(driven) if joint.name in robot.gripper_joints]
        self._arm = [index for index in range(len(driven)) if index not in fingers]
        self._joints = [robot.driven[index] for index in self._arm]
        self._fingers, self._robot, self._delta = fingers, robot.name, delta_rad
        self.names = (*(driven[index].name for index in self._arm), *(["gripper"] if fingers else []))
        self.low, self.high = -np.ones(len(self.names), np.float32), np.ones(len(self.names), np.float32)
        limits = [driven[index].target_range or driven[index].range for index in fingers]
        self._middle = torch.tensor([(low + high) / 2 for low, high in limits])
        self._half = torch.tensor([(high - low) / 2 for low, high in limits])

    @override
    def apply(self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None) -> None:
        targets = self._targets(handler.get_joint_positions(self._robot, env_ids), actions)
        handler.set_joint_targets({self._robot: targets}, env_ids)

    @override
    def advance(
        self, handler: Handler, actions: np.ndarray | Tensor, num_steps: int, env_ids: EnvIds = None
    ) -> None:
        targets = self._targets(handler.get_joint_positions(self._robot, env_ids), actions)
        handler.step_towards({self._robot: targets}, num_steps, env_ids)

    @override
    def as_task_actions(self, state: State, actions: np.ndarray) -> np.ndarray:
        return self._targets(state.robots[self._robot].joint_pos, actions).cpu().numpy()

    def _targets(self, joints: Tensor, actions: np.ndarray | Tensor) -> Tensor:
        """Returns where the targets of the driven joints are to be, from where the joints are, (n, J)."""
        given = torch.as_tensor(actions, device=joints.device).to(joints.dtype).clamp(-1.0, 1.0)
        self._middle, self._half = self._middle.to(joints), self._half.to(joints)
        parts = [joints[:, self._joints] + self._delta * given[:, : len(self._arm)]]
        order = [*self._arm, *self._fingers]
        if self._fingers:
            parts.append(self._middle + self._half * given[:, -1:])
        targets = torch.cat(parts, dim=-1)
        if order != sorted(order):
            targets = targets[:, [order.index(index) for index in range(len(order))]]
        return targets

    @override
    def hold(self, state: State) -> np.ndarray:
        target = state.robots[self._robot].joint_target
        assert target is not None, "a simulator gives every robot's targets"
        still = torch.zeros((len(target), len(self.names)), dtype=target.dtype)
        if self._fingers:
            finger = target[:, self._fingers[0]].cpu()
            still[:, -1] = (finger - self._middle[0].cpu()) / self._half[0].cpu()
        return still.numpy()


class NormalizedPositionController(Controller):
    """An action is the target of every driven joint of one robot, a position or a torque, within its range.

    An entry of -1 is the least target of the joint's actuator, 1 the largest; what lies beyond is clipped.
    This is HumanoidBench's control (``tasks.py``, ``unnormalize_action``).

    Args:
        robot: The robot.
    """

    def __init__(self, robot: RobotCfg) -> None:
        joints = [robot.joints[index] for index in robot.driven]
        self.names = tuple(joint.name for joint in joints)
        self.low, self.high = -np.ones(len(joints), np.float32), np.ones(len(joints), np.float32)
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
    """An action moves the position targets of an arm's joints away from their rest; its fingers stay there.

    This is Isaac Lab's ``JointPositionActionCfg`` with ``use_default_offset``. Every entry lies in [-1, 1];
    what lies beyond is clipped.

    Args:
        robot: A robot with position actuators.
        scale_rad: Distance from the rest position at an action of 1, rad.
    """

    def __init__(self, robot: RobotCfg, scale_rad: float) -> None:
        self._arm = [i for i, joint in enumerate(robot.joints) if joint.name not in robot.gripper_joints]
        self.names = tuple(robot.joints[index].name for index in self._arm)
        self.low, self.high = -np.ones(len(self._arm), np.float32), np.ones(len(self._arm), np.float32)
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
    """An action moves the object that pulls a robot's hand, and presses the fingers: x, y, z, gripper.

    This is Meta-World's control (``sawyer_xyz_env.py``, ``set_xyz_action``). Every entry lies in [-1, 1];
    what lies beyond is clipped.

    Args:
        robot: A robot whose driven joints are two fingers that close towards each other along one axis.
        target: Name of the object that pulls the hand.
        low: Least position of the target, m, (3,).
        high: Largest position of the target, m, (3,).
        step_m: Way of the target at an action of 1.
        rot: Orientation of the target, wxyz.
    """

    def __init__(
        self, robot: RobotCfg, target: str, *, low: Vec3, high: Vec3, step_m: float, rot: Quat
    ) -> None:
        self.names = ("x", "y", "z", "gripper")
        self.low, self.high = -np.ones(4, np.float32), np.ones(4, np.float32)
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

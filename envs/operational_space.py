"""robosuite's operational-space controller of the hand's pose: torques from pose deltas at 20 Hz.

After Khatib (1987, doi:10.1109/JRA.1987.1087068), with the gains, scalings and order of operations of
robosuite 1.4's ``OSC_POSE`` (``controllers/osc.py``, ``controllers/config/osc_pose.json``,
``utils/control_utils.py``, MIT), in which LIBERO's and robomimic's demonstrations were recorded.

Shapes: n environments, K joints of the arm, J joints of the robot.
"""

from dataclasses import dataclass
from typing import override

import mujoco
import numpy as np
import torch
from mujoco.batch import Batch
from torch import Tensor

from envs.array_ops import Array, to_numpy
from envs.controllers import Controller
from envs.core.errors import ConfigError
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_models
from envs.scenario import RobotCfg, ScenarioCfg
from envs.simulators.base import EnvIds, Handler, rows_of
from envs.state import State

DELTA_M, DELTA_RAD = 0.05, 0.5
"""Distance and angle of the hand's goal at an action of 1: ``output_max``."""

STIFFNESS = 150.0
"""``kp``, 1/s²; the damping is critical, ``kd = 2 sqrt(kp)``."""

POSTURE_STIFFNESS = 10.0
"""``joint_kp`` of the posture that is kept where it does not move the hand, 1/s²."""

FINGER_STEP_M = 0.0002
"""How far a finger's target moves in a physics step: ``speed`` 0.01 of half a stroke of 0.02 m."""

_NAMES = ("x", "y", "z", "roll", "pitch", "yaw", "gripper")
_PINV_RCOND = 1e-15


@dataclass(frozen=True, slots=True)
class ArmDynamics:
    """Hands of n arms, and what moves them.

    Attributes:
        pos: Position of the end effector in the world, m, (n, 3).
        rot: Its orientation, (n, 3, 3).
        jacobian: Its linear velocity (first three rows) and angular velocity in the world per joint velocity,
            (n, 6, K).
        inertia: Joint-space inertia with the rotors', kg·m², (n, K, K).
        bias: Torques of gravity, Coriolis and centrifugal forces, N·m, (n, K).
    """

    pos: np.ndarray
    rot: np.ndarray
    jacobian: np.ndarray
    inertia: np.ndarray
    bias: np.ndarray


class ArmModel:
    """Kinematics and dynamics of a robot by itself, for many states at once.

    Args:
        robot: The robot.
        num_envs: Most states of one call.
    """

    def __init__(self, robot: RobotCfg, num_envs: int) -> None:
        scenario = ScenarioCfg(robots=(robot,), table=None, room=None)
        self._model = model = build_models(scenario)[1]
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._batch = Batch(model, num_envs)
        layout = layout_of(model, scenario).robots[0]
        self._qpos, self._qvel = layout.qpos, layout.qvel
        self._arm = layout.qvel[list(robot.arm)]
        self._site, self._body = layout.ee_site, int(model.site_bodyid[layout.ee_site])
        names = ("site_xpos", "site_xmat", "M", "qfrc_bias")
        self._site_pos, self._site_rot, self._inertia, self._bias = map(self._batch.bind, names)
        # M is the lower triangle, row by row, without the entries that are always 0.
        self._row = np.repeat(np.arange(model.nv), model.M_rownnz)
        self._column = np.array(model.M_colind[: len(self._row)])

    def at(self, qpos: np.ndarray, qvel: np.ndarray) -> ArmDynamics:
        """Returns the dynamics at positions and velocities of all joints, (n, J) each, rad and m."""
        ids = np.arange(len(qpos))
        self._batch.qpos[ids[:, None], self._qpos] = qpos
        self._batch.qvel[ids[:, None], self._qvel] = qvel
        self._batch.forward(ids, stage=int(mujoco.mjtStage.mjSTAGE_VEL))
        pos = self._site_pos[ids, self._site]
        linear, angular = self._batch.jac(self._body, pos, ids)
        inertia = np.zeros((len(ids), self._model.nv, self._model.nv))
        inertia[:, self._row, self._column] = self._inertia[ids]
        inertia[:, self._column, self._row] = self._inertia[ids]
        return ArmDynamics(
            pos=pos,
            rot=self._site_rot[ids, self._site].reshape(-1, 3, 3),
            jacobian=np.concatenate([linear, angular], axis=1)[:, :, self._arm],
            inertia=inertia[:, self._arm[:, None], self._arm],
            bias=self._bias[ids][:, self._arm],
        )


class OperationalSpaceController(Controller):
    """An action moves the goal of the hand's pose from where the hand is, and opens or closes the gripper.

    The entries are x, y, z, a rotation vector, both about the world's axes, and the gripper; all are clipped
    to [-1, 1]. At 1 the goal is :data:`DELTA_M` or :data:`DELTA_RAD` from the hand's present pose; a rotation
    of exactly zero keeps the former goal's orientation. The gripper closes above 0, opens below, and stops at
    0. Torques are computed again in each physics step.

    Args:
        robot: A robot whose arm is driven by torques, whose gravity is not compensated, and whose fingers are
            driven to positions; its default posture is the one that is kept.

    Raises:
        ConfigError: The robot is another one.
    """

    def __init__(self, robot: RobotCfg) -> None:
        arm, fingers = robot.arm, robot.fingers
        drives = [robot.joints[index].drive for index in (*arm, *fingers)]
        if drives != ["torque"] * len(arm) + ["position"] * len(fingers) or robot.gravity_compensated:
            raise ConfigError(
                f"OSC_POSE drives an arm by torques against gravity, and '{robot.name}' is not such a robot: "
                "give its arm's joints drive='torque', its fingers positions, and gravity_compensated=False."
            )
        self.names = _NAMES if fingers else _NAMES[:-1]
        self.low, self.high = -np.ones(len(self.names), np.float32), np.ones(len(self.names), np.float32)
        self.held = ("zero",) * len(self.names)
        self._robot, self._arm, self._fingers = robot, list(arm), list(fingers)
        self._driven = list(robot.driven)
        self._rest = np.array(robot.default_qpos)[self._arm]
        self._open = np.array([wide for _, wide in robot.finger_limits])
        self._shut = np.array([shut for shut, _ in robot.finger_limits])
        self._model: ArmModel | None = None
        self._goal_rot = np.empty((0, 3, 3))

    @override
    def begin(self, env_ids: Array) -> None:
        if len(self._goal_rot):
            self._goal_rot[to_numpy(env_ids)] = np.nan

    @override
    def apply(self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None) -> None:
        self._run(handler, actions, 0, env_ids)

    @override
    def advance(
        self, handler: Handler, actions: np.ndarray | Tensor, num_steps: int, env_ids: EnvIds = None
    ) -> None:
        self._run(handler, actions, num_steps, env_ids)

    def _run(self, handler: Handler, actions: np.ndarray | Tensor, num_steps: int, env_ids: EnvIds) -> None:
        """Sets the goal, and runs the control loop for ``num_steps`` physics steps; for 0, its first half."""
        if self._model is None or len(self._goal_rot) != handler.num_envs:
            self._model = ArmModel(self._robot, handler.num_envs)
            self._goal_rot = np.full((handler.num_envs, 3, 3), np.nan)
        rows = rows_of(env_ids, handler.num_envs)
        given = np.clip(torch.as_tensor(actions).double().cpu().numpy(), -1.0, 1.0)
        fingers = handler.get_joint_targets(self._robot.name, env_ids).cpu().numpy()
        fingers = fingers[:, [self._driven.index(index) for index in self._fingers]]
        goal_pos = goal_rot = None
        for _ in range(max(num_steps, 1)):
            robot = handler.get_states(env_ids).robots[self._robot.name]
            qpos, qvel = robot.joint_pos.cpu().numpy(), robot.joint_vel.cpu().numpy()
            arm = self._model.at(qpos, qvel)
            if goal_pos is None or goal_rot is None:
                goal_pos = arm.pos + DELTA_M * given[:, :3]
                goal_rot = self._next_rot(rows, arm.rot, DELTA_RAD * given[:, 3:6])
            torques = hand_torques(
                arm, goal_pos, goal_rot, self._rest - qpos[:, self._arm], qvel[:, self._arm]
            )
            fingers = self._next_fingers(fingers, given[:, 6:])
            targets = np.empty((len(rows), len(self._driven)))
            targets[:, [self._driven.index(index) for index in self._arm]] = torques
            targets[:, [self._driven.index(index) for index in self._fingers]] = fingers
            handler.set_joint_targets({self._robot.name: targets}, env_ids)
            if num_steps:
                handler.step(1, env_ids)

    def _next_rot(self, rows: np.ndarray, present: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Returns the goal's orientations (n, 3, 3), and remembers them."""
        goal = self._goal_rot[rows]
        fresh = np.isnan(goal[:, 0, 0])
        goal[fresh] = present[fresh]
        turned = turn.any(axis=1)
        goal[turned] = _rotations(turn[turned]) @ present[turned]
        self._goal_rot[rows] = goal
        return goal

    def _next_fingers(self, targets: np.ndarray, gripper: np.ndarray) -> np.ndarray:
        moved = targets - FINGER_STEP_M * np.sign(gripper)
        return np.clip(moved, self._shut, self._open)

    @override
    def hold(self, state: State) -> np.ndarray:
        return np.zeros((state.num_envs, len(self.names)))


def hand_torques(
    arm: ArmDynamics, goal_pos: np.ndarray, goal_rot: np.ndarray, posture_error: np.ndarray, qvel: np.ndarray
) -> np.ndarray:
    """Returns the torques (n, K), N·m, that drive the hands to their goals; not clipped.

    Forces on position and on orientation are decoupled from each other (``uncouple_pos_ori``), and the
    posture is kept in the null space of the hand's motion.

    Args:
        arm: The present dynamics.
        goal_pos: Positions to reach, m, (n, 3).
        goal_rot: Orientations to reach, (n, 3, 3).
        posture_error: Kept posture minus the present one, rad, (n, K).
        qvel: Joint velocities, rad/s, (n, K).
    """
    jacobian, inertia = arm.jacobian, arm.inertia
    turned = jacobian.transpose(0, 2, 1)
    inverse = np.linalg.inv(inertia)
    mobility = jacobian @ inverse @ turned  # (n, 6, 6)
    velocity = (jacobian @ qvel[..., None])[..., 0]
    # Half the sum of the cross products of the axes: the sine of the angle times its axis.
    error = 0.5 * np.cross(arm.rot, goal_rot, axis=1).sum(axis=2)
    error = np.concatenate([goal_pos - arm.pos, error], axis=1)
    wanted = STIFFNESS * error - 2.0 * np.sqrt(STIFFNESS) * velocity
    masses = [np.linalg.pinv(mobility[:, part, part], _PINV_RCOND) for part in (slice(3), slice(3, 6))]
    parts = [mass @ wanted[:, part, None] for mass, part in zip(masses, (slice(3), slice(3, 6)), strict=True)]
    torques = turned @ np.concatenate(parts, axis=1)
    kept = POSTURE_STIFFNESS * posture_error - 2.0 * np.sqrt(POSTURE_STIFFNESS) * qvel
    mass = np.linalg.pinv(mobility, _PINV_RCOND)
    null = np.eye(inertia.shape[1]) - inverse @ turned @ mass @ jacobian
    posture = null.transpose(0, 2, 1) @ (inertia @ kept[..., None])
    return (torques + posture)[..., 0] + arm.bias


def _rotations(vectors: np.ndarray) -> np.ndarray:
    """Returns the rotation matrices (n, 3, 3) of rotation vectors (n, 3), rad."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = (vectors / np.maximum(angle[..., 0], 1e-12)).T
    zero = np.zeros_like(x)
    skew = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    return np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * (skew @ skew)

"""CALVIN's own interface: relative Cartesian actions at 30 Hz, and its observation of the robot.

``calvin_env/robot/robot.py`` (MIT): an action moves the target of the hand's position by 2 cm and its Euler
angles by 0.05 rad at most, and opens the gripper (1) or closes it (-1). The point that is moved, ``tcp``, is
the one between our fingertips; CALVIN's fingers are 4.5 cm longer.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import override

import numpy as np
import torch
from torch import Tensor

from envs.hand_pose_controller import HandPoseController
from envs.kinematics.waypoints import Waypoint, interpolate
from envs.rotations import from_euler, from_matrix, multiply, to_matrix, wrapped
from envs.scenario import RobotCfg, ScenarioCfg
from envs.state import EntityState, State
from envs.tasks.arm_at_table import chain_at_rest, posed
from envs.tasks.waypoint_planner import Expert

MAX_REL_POS_M, MAX_REL_ORN_RAD = 0.02, 0.05
"""``max_rel_pos`` and ``max_rel_orn``."""

STATE_NAMES = (
    *("tcp_x", "tcp_y", "tcp_z", "tcp_roll", "tcp_pitch", "tcp_yaw", "gripper_opening_width"),
    *(f"robot_joint_{index}" for index in range(7)),
    "gripper_action",
)
"""``robot_obs``: m, rad about fixed axes, m, rad, and 1 for an open gripper or -1."""

STATE_LIMITS = (
    (-2.0,) * 3 + (-3.2,) * 3 + (-0.1,) + (-4.0,) * 7 + (-1.0,),
    (2.0,) * 3 + (3.2,) * 3 + (0.2,) + (4.0,) * 7 + (1.0,),
)

_TCP = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
"""CALVIN's ``tcp`` in our ``grip_site``: its fingers open along y."""

_INNER_RAD = 0.2
"""Unit of turns of the controller below: larger than any that three Euler angles add up to."""

FASTEST = 0.9
"""Share of the largest action that the expert uses: the rest is for errors."""

PEAK = 1.875
"""Largest speed of a movement of least jerk against its mean speed."""


def euler_of(rot: Tensor) -> Tensor:
    """Returns roll, pitch and yaw about fixed axes (N, 3) of matrices (N, 3, 3)."""
    roll = torch.atan2(rot[:, 2, 1], rot[:, 2, 2])
    pitch = -torch.asin(rot[:, 2, 0].clamp(-1.0, 1.0))
    return torch.stack([roll, pitch, torch.atan2(rot[:, 1, 0], rot[:, 0, 0])], -1)


def matrix_of(euler: Tensor) -> Tensor:
    """Inverts :func:`euler_of`."""
    (cr, cp, cy), (sr, sp, sy) = euler.cos().unbind(-1), euler.sin().unbind(-1)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def _rotation_vectors(rot: Tensor) -> Tensor:
    """Returns axis times angle (N, 3) of small turns (N, 3, 3)."""
    skew = torch.stack(
        [rot[:, 2, 1] - rot[:, 1, 2], rot[:, 0, 2] - rot[:, 2, 0], rot[:, 1, 0] - rot[:, 0, 1]], -1
    )
    sine = (skew.norm(dim=-1, keepdim=True) / 2).clamp(max=1.0)
    return skew / 2 * torch.where(sine > 1e-9, torch.asin(sine) / sine.clamp(min=1e-9), torch.ones_like(sine))


def tcp_rotation(site: Tensor) -> Tensor:
    """Returns orientations of CALVIN's ``tcp`` (N, 3, 3) of hands whose ``grip_site`` is so oriented."""
    return site @ site.new_tensor(_TCP)


class RelativeCartesianController(HandPoseController):
    """CALVIN's ``cartesian_rel``: x, y, z, roll, pitch, yaw of the target, and the gripper; all in [-1, 1].

    Args:
        robot: A Panda with position actuators and gravity compensation.
    """

    def __init__(self, robot: RobotCfg) -> None:
        super().__init__(robot, delta_m=MAX_REL_POS_M, delta_rad=_INNER_RAD)

    @override
    def moved_targets(self, joints: Tensor, targets: Tensor, actions: np.ndarray | Tensor) -> Tensor:
        given = torch.as_tensor(actions, device=joints.device).double().clamp(-1.0, 1.0)
        now = tcp_rotation(self.target_pose(joints, targets)[1])
        wanted = matrix_of(euler_of(now) + MAX_REL_ORN_RAD * given[:, 3:6])
        turn = _rotation_vectors(wanted @ now.transpose(1, 2)) / _INNER_RAD
        gripper = torch.where(given[:, 6:7] > 0.0, 1.0, -1.0)
        return super().moved_targets(joints, targets, torch.cat([given[:, :3], turn, gripper], -1))


def robot_obs(cfg: RobotCfg, robot: EntityState) -> Tensor:
    """Returns CALVIN's ``robot_obs`` (N, 15); see :data:`STATE_NAMES`.

    Args:
        cfg: A Panda.
        robot: Its state, of tensors.
    """
    assert robot.ee_pos is not None and robot.ee_rot is not None and robot.joint_target is not None
    fingers = list(cfg.fingers)
    width = robot.joint_pos[:, fingers].sum(-1, keepdim=True)
    columns = [list(cfg.driven).index(finger) for finger in fingers]
    opens = robot.joint_target[:, columns].sum(-1, keepdim=True) > 0.04
    euler = euler_of(tcp_rotation(to_matrix(robot.ee_rot)))
    action = torch.where(opens, 1.0, -1.0).to(width.dtype)
    return torch.cat([robot.ee_pos, euler, width, robot.joint_pos[:, list(cfg.arm)], action], -1)


class RelativeCartesianPlanner:
    """Follows an expert's waypoints with :class:`RelativeCartesianController`, no faster than it can.

    Args:
        scenario: The scene.
        expert: Returns waypoints for a state of one row.
    """

    def __init__(self, scenario: ScenarioCfg, expert: Expert) -> None:
        self._expert, self._robot = expert, scenario.robots[0]
        self._control_hz = scenario.physics.control_hz

    def plan(self, state: State, rng: np.random.Generator) -> np.ndarray:
        """Returns the next actions (T, 7) float32, or none; see :class:`envs.tasks.planner.Planner`."""
        waypoints = self._expert(state, rng)
        if not waypoints:
            return np.zeros((0, 7), np.float32)
        chain, rest = chain_at_rest(self._robot)
        robot = state.robots[self._robot.name]
        assert robot.joint_target is not None, "a simulator gives every robot's targets"
        posture = robot.joint_pos[:1].to(torch.float64, copy=True)
        posture[:, list(self._robot.driven)] = robot.joint_target[:1].to(posture)
        poses = chain(posture[:, chain.columns])
        first = posed(self._robot, poses.pos[0].numpy(), from_matrix(poses.rot[0].numpy()), 0.0, 0.0)
        path = interpolate(first, self._slowed(first, waypoints), self._control_hz)
        rots = torch.from_numpy(to_matrix(multiply(from_euler(np.vstack([first.turn, path.turn])), rest)))
        euler = euler_of(tcp_rotation(rots)).numpy()
        turned = wrapped(np.diff(euler, axis=0))
        moved = np.diff(np.vstack([first.pos, path.pos]), axis=0)
        gripper = np.where(path.gripper > 0.02, 1.0, -1.0)[:, None]
        actions = np.hstack([moved / MAX_REL_POS_M, turned / MAX_REL_ORN_RAD, gripper])
        return actions.clip(-1.0, 1.0).astype(np.float32)

    def _slowed(self, first: Waypoint, waypoints: Sequence[Waypoint]) -> list[Waypoint]:
        """Returns waypoints with the time that the largest action needs for them."""
        last, slowed = first, []
        for waypoint in waypoints:
            steps = np.max(np.abs(waypoint.pos - last.pos)) / MAX_REL_POS_M
            steps = max(steps, float(np.abs(waypoint.turn - last.turn).sum()) / MAX_REL_ORN_RAD)
            needed = PEAK * steps / (FASTEST * self._control_hz)
            slowed.append(replace(waypoint, duration_s=max(waypoint.duration_s, float(needed))))
            last = waypoint
        return slowed

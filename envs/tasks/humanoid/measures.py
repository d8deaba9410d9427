"""Measurements of HumanoidBench's rewards on an H1 (``robots.py``), and the terms that its tasks share."""

import math
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor

from envs.kinematics.body_poses import BodyTree
from envs.mjcf.drives import DriveLengths
from envs.scenario import RobotCfg, Vec3
from envs.state import EntityState
from envs.tasks.rewards import tolerance

STAND_HEIGHT_M = 1.65
"""Height of the head at which standing has its full reward."""

HEAD: tuple[str, Vec3] = ("torso_link", (0.0, 0.0, 0.7))
IMU: tuple[str, Vec3] = ("torso_link", (-0.04452, -0.01891, 0.27756))
FEET: tuple[tuple[str, Vec3], ...] = (
    ("left_ankle_link", (0.0, 0.0, -0.05)),
    ("right_ankle_link", (0.0, 0.0, -0.05)),
)
"""Sites of ``robots/h1_pos.xml``: the body that carries each, and where."""


@dataclass(frozen=True, slots=True)
class Measures:
    """An H1 in N states.

    Attributes:
        head: Place of the head, m, (N, 3).
        imu: Place of the inertial sensor in the chest, m, (N, 3).
        feet: Heights of the left and the right foot, m, (N, 2).
        upright: How far the torso's z axis points up, in [-1, 1], (N,).
        com_vel: Velocity of the centre of mass, m/s, (N, 3).
        forces: Torques of the actuators, N·m, (N, 19), or (N, 61) with hands.
    """

    head: Tensor
    imu: Tensor
    feet: Tensor
    upright: Tensor
    com_vel: Tensor
    forces: Tensor

    @property
    def small_control(self) -> Tensor:
        """From 0.8 for large torques to 1 for none, (N,)."""
        small = tolerance(self.forces, margin=10.0, value_at_margin=0.0, shape="quadratic")
        return (4.0 + small.mean(-1)) / 5.0

    def standing(self, height_m: float = STAND_HEIGHT_M) -> Tensor:
        """Returns how high the head is, (N,)."""
        return tolerance(self.head[:, 2], height_m, math.inf, margin=STAND_HEIGHT_M / 4)

    def straight(self, bound: float, margin: float = 1.9) -> Tensor:
        """Returns how upright the torso is, (N,)."""
        return tolerance(self.upright, bound, math.inf, margin=margin, value_at_margin=0.0, shape="linear")

    def moving(self, speed_m_s: float) -> Tensor:
        """Returns from 1/6 at rest to 1 at a speed along x, (N,)."""
        move = tolerance(
            self.com_vel[:, 0], speed_m_s, math.inf, margin=speed_m_s, value_at_margin=0.0, shape="linear"
        )
        return (5.0 * move + 1.0) / 6.0

    @property
    def still(self) -> Tensor:
        """Reward for low speed along x and y, (N,)."""
        return tolerance(self.com_vel[:, :2], margin=2.0).mean(-1)


def measure(tree: BodyTree, cfg: RobotCfg, robot: EntityState) -> Measures:
    """Measures the H1 ``cfg``, whose bodies are ``tree``, in its states."""
    bodies = tree(robot)
    head, imu, left, right = (
        tree.place(bodies, tree.index(name), offset) for name, offset in (HEAD, IMU, *FEET)
    )
    return Measures(
        head=head,
        imu=imu,
        feet=torch.stack([left[:, 2], right[:, 2]], dim=-1),
        upright=bodies.rot[:, tree.index(HEAD[0]), 2, 2],
        com_vel=tree.com_velocity(bodies),
        forces=actuator_forces(cfg, robot),
    )


def actuator_forces(cfg: RobotCfg, robot: EntityState) -> Tensor:
    """Returns the torques of a robot's position actuators, N·m, (N, D)."""
    assert robot.joint_target is not None, "a simulator gives every robot's targets"
    kp, kd, limit, lengths = _drives(cfg, robot.joint_pos.device, robot.joint_pos.dtype)
    force = kp * (robot.joint_target - lengths(robot.joint_pos)) - kd * lengths(robot.joint_vel)
    return torch.minimum(torch.maximum(force, -limit), limit)


@lru_cache(maxsize=8)
def _drives(
    cfg: RobotCfg, device: torch.device, dtype: torch.dtype
) -> tuple[Tensor, Tensor, Tensor, DriveLengths]:
    rows = [(joint.kp, joint.kd, joint.force_limit) for joint in cfg.joints if joint.driven]
    kp, kd, limit = torch.tensor(rows, device=device, dtype=dtype).unbind(-1)
    return kp, kd, limit, DriveLengths(cfg)

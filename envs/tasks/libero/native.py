"""LIBERO's own interface: robosuite's actions, and the observations of LeRobot's environment ``libero``.

With ``action_space=native`` a task takes robosuite's ``OSC_POSE`` actions, 7 numbers at 20 Hz. With
``observation_space=native`` it gives the images ``image`` and ``image2`` and a state of 8 numbers
(``lerobot/envs/libero.py`` and ``lerobot/processor/env_processor.py`` of LeRobot 0.6, Apache-2.0), so a
policy that was trained on LIBERO's public datasets runs unchanged.
"""

from dataclasses import replace
from functools import lru_cache

import torch
from torch import Tensor

from envs.kinematics.tree import path_to
from envs.mjcf.model import build_models
from envs.robots.franka import FRANKA_TORQUE
from envs.rotations import multiply
from envs.scenario import LightCfg, RobotCfg, ScenarioCfg
from envs.state import EntityState

CAMERAS = {"agentview": "image", "robot0_eye_in_hand": "image2"}
"""LIBERO's cameras, and what LeRobot calls their images."""

STATE_NAMES = ("x", "y", "z", "axis_angle_x", "axis_angle_y", "axis_angle_z", "finger_1", "finger_2")
"""Position of ``grip_site``, m; orientation of ``right_hand``, axis times angle, rad; ``gripper_qpos``, m."""

STATE_LIMITS = ((-2.0,) * 3 + (-7.0,) * 3 + (-0.1,) * 2, (2.0,) * 3 + (7.0,) * 3 + (0.1,) * 2)
"""Bounds of the entries; an axis times an angle of up to a full turn, which LeRobot does not shorten."""

AIR = {"integrator": "euler", "density": 1.2, "viscosity": 2e-5}
"""robosuite's options of MuJoCo (``models/assets/base.xml``); drag slows its arm of large inertias."""

LIGHTS = (
    LightCfg(kind="distant", direction=(-0.3, 0.0, -1.0), intensity=0.35),
    LightCfg(kind="area", pos=(1.0, 1.0, 4.0), direction=(0.0, -0.15, -1.0), intensity=0.4),
)
"""In place of MuJoCo's light at the camera, and LIBERO's ``light1``; neither casts shadows there.

Intensities are fitted to images of the original, whose lights shade a mesh by its corners.
"""

_HAND = "right_hand"


def with_native_robot(scenario: ScenarioCfg) -> ScenarioCfg:
    """Returns a scene whose Panda is driven by torques, as robosuite drives it, at the same place."""
    own = scenario.robots[0]
    robot = replace(FRANKA_TORQUE, pos=own.pos, rot=own.rot).with_home(own.default_qpos)
    settings = {**scenario.simulators, "mujoco": {**scenario.simulators.get("mujoco", {}), **AIR}}
    return replace(scenario, robots=(robot,), simulators=settings)


def with_native_view(scenario: ScenarioCfg) -> ScenarioCfg:
    """Returns a scene lit as LIBERO's, whose cameras have the names of LeRobot's images."""
    cameras = (replace(camera, name=CAMERAS[camera.name]) for camera in scenario.cameras)
    return replace(scenario, cameras=tuple(cameras), appearance=replace(scenario.appearance, lights=LIGHTS))


def native_state(cfg: RobotCfg, robot: EntityState) -> Tensor:
    """Returns the state (N, 8) that LeRobot's environment of LIBERO gives; see :data:`STATE_NAMES`.

    Args:
        cfg: A Panda.
        robot: Its state, of tensors.
    """
    assert robot.ee_pos is not None, "a simulator gives every robot's end effector"
    fingers = robot.joint_pos[:, list(cfg.fingers)] * robot.joint_pos.new_tensor([1.0, -1.0])
    turn = axis_angle(hand_rotation(cfg, robot.joint_pos))
    return torch.cat([robot.ee_pos, turn, fingers], dim=-1)


def hand_rotation(cfg: RobotCfg, joint_pos: Tensor) -> Tensor:
    """Returns the orientation of ``right_hand`` (N, 4), wxyz, with the sign that MuJoCo gives it.

    MuJoCo multiplies the quaternions from the base on and never changes their sign, on which
    :func:`axis_angle` depends. That of a rotation matrix would jump.

    Args:
        cfg: The robot; its arm has hinges about the z axes of their bodies.
        joint_pos: Positions of all joints, rad, (N, J).
    """
    fixed = [torch.tensor(quat).to(joint_pos) for quat in _fixed_rotations(cfg)]
    arm = list(cfg.arm)
    zero = torch.zeros_like(joint_pos[:, 0])
    rot = fixed[0].expand(len(joint_pos), 4)
    for column, after in zip(arm, fixed[1:], strict=True):
        half = joint_pos[:, column] / 2
        rot = multiply(rot, torch.stack([half.cos(), zero, zero, half.sin()], -1))
        rot = multiply(rot, after.expand_as(rot))
    return rot


@lru_cache(maxsize=4)
def _fixed_rotations(cfg: RobotCfg) -> tuple[tuple[float, ...], ...]:
    """Returns the constant rotations before the first joint, and after each: K + 1 quaternions, wxyz."""
    model = build_models(ScenarioCfg(robots=(cfg,), table=None, room=None))[1]
    parts = [torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)]
    for body in path_to(model, model.body(f"{cfg.name}/{_HAND}").id):
        quat = torch.from_numpy(model.body_quat[body.index].copy())
        parts[-1] = multiply(parts[-1][None], quat[None])[0]
        if model.body_jntnum[body.index]:
            parts.append(torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64))
    return tuple(tuple(part.tolist()) for part in parts)


def axis_angle(rot: Tensor) -> Tensor:
    """Returns axis times angle (N, 3), rad, of quaternions (N, 4), wxyz; the angle is from 0 to a full turn.

    LeRobot's ``LiberoProcessorStep``: a quaternion whose w is negative gives more than half a turn.
    """
    w = rot[:, :1].clamp(-1.0, 1.0)
    sine = (1.0 - w * w).clamp(min=0.0).sqrt()
    scale = torch.where(sine > 1e-10, 2.0 * torch.acos(w) / sine.clamp(min=1e-10), torch.zeros_like(w))
    return rot[:, 1:] * scale

"""Forward kinematics and Jacobians of one end effector, for N postures at once.

Shapes: N postures, K joints between the world and the end effector, J joints of the robot.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from torch import Tensor

from envs.core.errors import ConfigError
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.scenario import RobotCfg, ScenarioCfg

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True, slots=True)
class Poses:
    """End effectors of N postures, and how they move with the joints.

    Attributes:
        pos: Positions in the world, m, (N, 3).
        rot: Orientations, (N, 3, 3).
        jacobian: Linear velocity (first three rows) and angular velocity in the world per joint velocity,
            (N, 6, K).
    """

    pos: Tensor
    rot: Tensor
    jacobian: Tensor


class KinematicChain:
    """The joints from the world to a robot's end effector, as constants of one formula.

    The transform of a hinge by q is linear in sin q and cos q, that of a slide in q: of every joint there
    remain three constant matrices, and no loop over the bodies.

    Args:
        robot: The robot.
        device: Where to compute.

    Attributes:
        columns: Which joints of the robot, of its J, the K joints are.
        low: Least position of each of the K joints, (K,).
        high: Largest position, (K,).

    Raises:
        ConfigError: if a joint on the way is neither a hinge nor a slide.
    """

    def __init__(self, robot: RobotCfg, device: torch.device | str = "cpu") -> None:
        scenario = ScenarioCfg(robots=(robot,), table=None, room=None)
        model = build_model(scenario)
        layout = layout_of(model, scenario).robots[0]
        column_of = {int(address): column for column, address in enumerate(layout.qpos)}
        before, joints = np.eye(4), []
        for body in _way_to(model, int(model.site_bodyid[layout.ee_site])):
            before = before @ _transform(model.body_pos[body], model.body_quat[body])
            for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
                address = int(model.jnt_qposadr[joint])
                if address not in column_of:  # nobody moves it: it stays at rest
                    before = before @ _joint_transform(model, joint, float(model.qpos0[address]))
                    continue
                joints.append((joint, column_of[address], before))
                before = np.eye(4)
        site = before @ _transform(model.site_pos[layout.ee_site], model.site_quat[layout.ee_site])
        self._set_constants(model, joints, site, torch.device(device))

    def _set_constants(self, model: mujoco.MjModel, joints, site: np.ndarray, device: torch.device) -> None:
        def tensor(values) -> Tensor:
            return torch.as_tensor(np.array(values), dtype=torch.float64, device=device)

        ids = [joint for joint, _, _ in joints]
        self.columns = [column for _, column, _ in joints]
        self.low, self.high = tensor(model.jnt_range[ids]).T
        self._hinge = tensor(model.jnt_type[ids] == _HINGE)[:, None]
        self._axis, self._anchor = tensor(model.jnt_axis[ids]), tensor(model.jnt_pos[ids])
        parts = [[before @ part for part in _parts(model, joint)] for joint, _, before in joints]
        self._fixed, self._first, self._second = (tensor(part) for part in zip(*parts, strict=True))
        self._site = tensor(site)

    def __call__(self, qpos: Tensor) -> Poses:
        """Returns the end effectors of the postures ``qpos`` (N, K), float64."""
        hinge = self._hinge[:, 0].bool()
        first = torch.where(hinge, torch.sin(qpos), qpos)[..., None, None]
        second = torch.cos(qpos)[..., None, None]
        steps = self._fixed + first * self._first + second * self._second  # (N, K, 4, 4)
        frames, frame = [], None
        for step in steps.unbind(1):
            frame = step if frame is None else frame @ step
            frames.append(frame)
        assert frame is not None, "a robot has joints"
        end = frame @ self._site
        turns = torch.stack(frames, 1)
        axes = (turns[..., :3, :3] @ self._axis[..., None])[..., 0]  # (N, K, 3)
        anchors = (turns[..., :3, :3] @ self._anchor[..., None])[..., 0] + turns[..., :3, 3]
        pos = end[:, :3, 3]
        swings = torch.linalg.cross(axes, pos[:, None] - anchors)
        linear = torch.where(hinge[:, None], swings, axes)
        jacobian = torch.cat([linear, axes * self._hinge], -1).transpose(1, 2)
        return Poses(pos, end[:, :3, :3], jacobian)


def rotation_vector(rot: Tensor) -> Tensor:
    """Returns axis times angle (..., 3), rad, of rotation matrices (..., 3, 3); exact but near half turns."""
    skew = torch.stack(
        [rot[..., 2, 1] - rot[..., 1, 2], rot[..., 0, 2] - rot[..., 2, 0], rot[..., 1, 0] - rot[..., 0, 1]],
        -1,
    )
    sine = 0.5 * torch.linalg.vector_norm(skew, dim=-1, keepdim=True)
    cosine = 0.5 * (rot.diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True) - 1.0)
    angle = torch.atan2(sine, cosine)
    return torch.where(sine > 1e-9, angle / sine.clamp(min=1e-9), torch.ones_like(sine)) * 0.5 * skew


def _way_to(model: mujoco.MjModel, body: int) -> list[int]:
    way = []
    while body != 0:
        way.append(body)
        body = int(model.body_parentid[body])
    return way[::-1]


def _transform(pos: np.ndarray, quat: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = matrix.reshape(3, 3), pos
    return out


def _parts(model: mujoco.MjModel, joint: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The transform of a joint is the first + sin q (or q) times the second + cos q times the third.

    Rodrigues: R = a aᵀ + sin q [a]× + cos q (1 − a aᵀ), about the joint's anchor.
    """
    axis, anchor = model.jnt_axis[joint], model.jnt_pos[joint]
    fixed, first, second = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4))
    fixed[3, 3] = 1.0
    if model.jnt_type[joint] == _SLIDE:
        fixed[:3, :3], first[:3, 3] = np.eye(3), axis
    elif model.jnt_type[joint] == _HINGE:
        x, y, z = axis
        along = np.outer(axis, axis)
        fixed[:3, :3], second[:3, :3] = along, np.eye(3) - along
        first[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        fixed[:3, 3] = anchor - fixed[:3, :3] @ anchor
        first[:3, 3], second[:3, 3] = -first[:3, :3] @ anchor, -second[:3, :3] @ anchor
    else:
        kind = mujoco.mjtJoint(int(model.jnt_type[joint])).name
        raise ConfigError(f"Joint '{model.joint(joint).name}' is {kind}; kinematics knows hinges and slides.")
    # MuJoCo measures a joint from its reference position.
    offset = float(model.qpos0[model.jnt_qposadr[joint]])
    if model.jnt_type[joint] == _SLIDE:
        return fixed - offset * first, first, second
    sine, cosine = np.sin(offset), np.cos(offset)
    return fixed, cosine * first + sine * second, cosine * second - sine * first


def _joint_transform(model: mujoco.MjModel, joint: int, qpos: float) -> np.ndarray:
    fixed, first, second = _parts(model, joint)
    if model.jnt_type[joint] == _SLIDE:
        return fixed + qpos * first
    return fixed + np.sin(qpos) * first + np.cos(qpos) * second

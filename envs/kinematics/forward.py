"""Forward kinematics and Jacobians of one end effector, for N postures at once.

Shapes: N postures, K joints between the world and the end effector, J joints of the robot.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from envs.kinematics.tree import joints_of, path_to, transform
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.scenario import RobotCfg, ScenarioCfg


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
    """Forward kinematics and Jacobian of a robot's end effector: the joints from the world to it.

    Constant transforms between joints are merged, so that no body takes part that has no joint.

    Args:
        robot: The robot.
        device: Where to compute.

    Attributes:
        columns: Which joints of the robot, of its J, the K joints are.
        low: Least position of each of the K joints, (K,).
        high: Largest position, (K,).
        constants: Of every joint the three matrices that its transform is made of (K, 4, 4), see
            :class:`envs.kinematics.tree.TreeJoint`; the site in the last joint's frame (4, 4); of every joint
            axis (K, 3), anchor (K, 3), and 1 for a hinge, 0 for a slide (K,).

    Raises:
        ConfigError: if a joint on the way is neither a hinge nor a slide.
    """

    def __init__(self, robot: RobotCfg, device: torch.device | str = "cpu") -> None:
        scenario = ScenarioCfg(robots=(robot,), table=None, room=None)
        model = build_model(scenario)
        layout = layout_of(model, scenario).robots[0]
        column_of = {int(address): column for column, address in enumerate(layout.qpos)}
        before, joints, transforms = np.eye(4), [], []
        self.columns: list[int] = []
        for body in path_to(model, int(model.site_bodyid[layout.ee_site])):
            before = before @ body.frame
            for joint in joints_of(model, body.index):
                if joint.qpos not in column_of:  # no joint of the robot: it stays at rest
                    before = before @ joint.at(joint.rest)
                    continue
                joints.append(joint)
                self.columns.append(column_of[joint.qpos])
                transforms.append([before @ part for part in (joint.fixed, joint.first, joint.second)])
                before = np.eye(4)
        site = before @ transform(model.site_pos[layout.ee_site], model.site_quat[layout.ee_site])

        def tensor(values) -> Tensor:
            return torch.as_tensor(np.array(values), dtype=torch.float64, device=device)

        self.low, self.high = tensor([joint.limits for joint in joints]).T
        self._hinge = tensor([joint.is_hinge for joint in joints])[:, None]
        self._axis, self._anchor = (
            tensor([joint.axis for joint in joints]),
            tensor([j.anchor for j in joints]),
        )
        self._fixed, self._first, self._second = (tensor(part) for part in zip(*transforms, strict=True))
        self._site = tensor(site)
        self.constants = (
            *(self._fixed, self._first, self._second, self._site),
            *(self._axis, self._anchor, self._hinge[:, 0]),
        )

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


def from_rotation_vector(vectors: Tensor) -> Tensor:
    """Returns the rotation matrices (N, 3, 3) of rotation vectors (N, 3), rad: axis times angle."""
    x, y, z = vectors.unbind(-1)
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    return torch.linalg.matrix_exp(skew)

"""Kinematic tree of a compiled model: bodies, and the transforms of their hinges and slides.

The transform of a hinge by q is linear in sin q and cos q, that of a slide is linear in q. So each joint is
three constant matrices, which forward kinematics of one end effector (:mod:`envs.kinematics.forward`) and of
all bodies (:mod:`envs.kinematics.body_poses`) evaluate for many states at once.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from envs.core.errors import ConfigError

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True, slots=True, eq=False)
class TreeJoint:
    """A hinge or a slide; its transform (4, 4) is ``fixed + s first + c second``.

    s is sin q of a hinge and q of a slide, c is cos q.

    Attributes:
        qpos: Address in qpos.
        is_hinge: Whether it is a hinge.
        axis: Unit axis in the body, (3,).
        anchor: A point of the axis in the body, m, (3,).
        limits: Least and largest position, rad or m.
        rest: Its position in the model's reference configuration.
        fixed: (4, 4).
        first: (4, 4).
        second: (4, 4); zero for a slide.
    """

    qpos: int
    is_hinge: bool
    axis: np.ndarray
    anchor: np.ndarray
    limits: tuple[float, float]
    rest: float
    fixed: np.ndarray
    first: np.ndarray
    second: np.ndarray

    def at(self, qpos: float) -> np.ndarray:
        """Returns the transform (4, 4) at one position."""
        if self.is_hinge:
            return self.fixed + np.sin(qpos) * self.first + np.cos(qpos) * self.second
        return self.fixed + qpos * self.first


@dataclass(frozen=True, slots=True, eq=False)
class TreeBody:
    """A body.

    Attributes:
        index: Its id in the model.
        parent: Its parent's id.
        name: Its name.
        frame: Its frame in its parent where all joints are at their reference position, (4, 4).
        mass: kg.
        com: Centre of mass in the body, m, (3,).
    """

    index: int
    parent: int
    name: str
    frame: np.ndarray
    mass: float
    com: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel, index: int) -> "TreeBody":
        """Reads a body of a compiled model."""
        return cls(
            index=index,
            parent=int(model.body_parentid[index]),
            name=model.body(index).name,
            frame=transform(model.body_pos[index], model.body_quat[index]),
            mass=float(model.body_mass[index]),
            com=model.body_ipos[index].copy(),
        )


def path_to(model: mujoco.MjModel, body: int) -> list[TreeBody]:
    """Returns the bodies from the world, which is left out, to a body."""
    path = []
    while body != 0:
        path.append(TreeBody.of(model, body))
        body = path[-1].parent
    return path[::-1]


def by_depth(model: mujoco.MjModel, root: int) -> list[list[TreeBody]]:
    """Returns a body and its descendants; those of one depth together, in the order of their ids."""
    depths = [[TreeBody.of(model, root)]]
    while depths[-1]:
        above = {body.index for body in depths[-1]}
        below = [index for index in range(1, model.nbody) if int(model.body_parentid[index]) in above]
        depths.append([TreeBody.of(model, index) for index in below])
    return depths[:-1]


def joints_of(model: mujoco.MjModel, body: int) -> list[TreeJoint]:
    """Returns the joints of a body.

    Raises:
        ConfigError: if one is neither a hinge nor a slide.
    """
    first = int(model.body_jntadr[body])
    return [_joint(model, joint) for joint in range(first, first + int(model.body_jntnum[body]))]


def transform(pos: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Returns a homogeneous transform (4, 4)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = matrix.reshape(3, 3), pos
    return out


def _joint(model: mujoco.MjModel, joint: int) -> TreeJoint:
    """Reads a joint. Rodrigues: R = a aᵀ + sin q [a]× + cos q (1 - a aᵀ), about the joint's anchor."""
    axis, anchor, kind = model.jnt_axis[joint], model.jnt_pos[joint], model.jnt_type[joint]
    fixed, first, second = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4))
    fixed[3, 3] = 1.0
    if kind == _SLIDE:
        fixed[:3, :3], first[:3, 3] = np.eye(3), axis
    elif kind == _HINGE:
        x, y, z = axis
        along = np.outer(axis, axis)
        fixed[:3, :3], second[:3, :3] = along, np.eye(3) - along
        first[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        fixed[:3, 3] = anchor - fixed[:3, :3] @ anchor
        first[:3, 3], second[:3, 3] = -first[:3, :3] @ anchor, -second[:3, :3] @ anchor
    else:
        name = mujoco.mjtJoint(int(kind)).name
        raise ConfigError(
            f"Joint '{model.joint(joint).name}' is {name}; kinematics supports hinges and slides."
        )
    # MuJoCo measures a joint from its reference position.
    address = int(model.jnt_qposadr[joint])
    rest = float(model.qpos0[address])
    if kind == _SLIDE:
        fixed = fixed - rest * first
    else:
        sine, cosine = np.sin(rest), np.cos(rest)
        first, second = cosine * first + sine * second, cosine * second - sine * first
    low, high = model.jnt_range[joint].tolist()
    return TreeJoint(
        address, kind == _HINGE, axis.copy(), anchor.copy(), (low, high), rest, fixed, first, second
    )

"""Loaders of converted robots: MuJoCo, PyBullet and UsdPhysics, each with poses and inertias of the links."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, override

import mujoco
import numpy as np

from envs.convert.source import compile_with_thin_meshes
from envs.mjcf.link_tree import Frame, Inertia, compose, inverse

Poses = dict[str, tuple[np.ndarray, np.ndarray]]
"""Link to position, m, and orientation, wxyz, in the world."""


class Reader(ABC):
    """One program that loaded a converted robot."""

    @abstractmethod
    def poses(self, joints: Mapping[str, float]) -> Poses:
        """Returns where each link is when the named joints are at these positions, rad (m)."""

    @abstractmethod
    def inertials(self) -> dict[str, Inertia]:
        """Returns mass and inertia of each link."""

    def close(self) -> None:  # noqa: B027 (most have nothing to free)
        """Frees it."""


class MujocoReader(Reader):
    """MuJoCo's own loader, of URDF and MJCF."""

    def __init__(self, path: Path) -> None:
        self._model = compile_with_thin_meshes(mujoco.MjSpec.from_file(str(path)), path.name)
        self._data = mujoco.MjData(self._model)

    @override
    def poses(self, joints: Mapping[str, float]) -> Poses:
        model, data = self._model, self._data
        for name, value in joints.items():
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        return {
            model.body(index).name: (data.xpos[index].copy(), data.xquat[index].copy())
            for index in range(model.nbody)
        }

    @override
    def inertials(self) -> dict[str, Inertia]:
        model = self._model
        return {
            model.body(index).name: Inertia(
                float(model.body_mass[index]),
                model.body_ipos[index],
                model.body_iquat[index],
                model.body_inertia[index],
            )
            for index in range(model.nbody)
        }


class PybulletReader(Reader):
    """PyBullet's loader of URDF."""

    def __init__(self, path: Path) -> None:
        import pybullet

        self._bullet = pybullet
        self._client = pybullet.connect(pybullet.DIRECT)
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        self._robot = pybullet.loadURDF(
            str(path), useFixedBase=False, flags=flags, physicsClientId=self._client
        )
        count = pybullet.getNumJoints(self._robot, physicsClientId=self._client)
        infos = [pybullet.getJointInfo(self._robot, i, physicsClientId=self._client) for i in range(count)]
        self._joints = {info[1].decode(): info[0] for info in infos}
        base = pybullet.getBodyInfo(self._robot, physicsClientId=self._client)[0].decode()
        self._links = {base: -1, **{info[12].decode(): info[0] for info in infos}}

    @override
    def poses(self, joints: Mapping[str, float]) -> Poses:
        bullet, client = self._bullet, self._client
        for name, value in joints.items():
            bullet.resetJointState(self._robot, self._joints[name], value, physicsClientId=client)
        return {name: self._pose(index) for name, index in self._links.items()}

    def _pose(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        bullet, client = self._bullet, self._client
        if index < 0:  # of the base, Bullet gives the pose of its centre of mass
            pos, rot = bullet.getBasePositionAndOrientation(self._robot, physicsClientId=client)
            com, turn = bullet.getDynamicsInfo(self._robot, -1, physicsClientId=client)[3:5]
            pos, rot = bullet.multiplyTransforms(pos, rot, *bullet.invertTransform(com, turn))
        else:
            state = bullet.getLinkState(
                self._robot, index, computeForwardKinematics=True, physicsClientId=client
            )
            pos, rot = state[4:6]
        return np.array(pos), np.array(rot)[[3, 0, 1, 2]]

    @override
    def inertials(self) -> dict[str, Inertia]:
        found = {}
        for name, index in self._links.items():
            info = self._bullet.getDynamicsInfo(self._robot, index, physicsClientId=self._client)
            rot = np.array(info[4])[[3, 0, 1, 2]]
            found[name] = Inertia(float(info[0]), np.array(info[3]), rot, np.array(info[2]))
        return found

    @override
    def close(self) -> None:
        self._bullet.disconnect(self._client)


_ORIGIN: Frame = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))


@dataclass(frozen=True, slots=True, eq=False)
class _UsdJoint:
    """A joint of UsdPhysics: its bodies' paths, its frame in the parent, and the child's in that frame."""

    name: str
    kind: str
    parent: Any
    child: Any
    frame: Frame
    back: Frame


class UsdReader(Reader):
    """Our own reading of UsdPhysics: joints by their frames, as its specification says they move."""

    def __init__(self, path: Path) -> None:
        from pxr import Usd, UsdGeom, UsdPhysics

        self._physics = UsdPhysics
        self._stage = Usd.Stage.Open(str(path))
        cache = UsdGeom.XformCache()
        # A joint's and a shape's display name is no link's; a link is a plain Xform.
        root = self._stage.GetDefaultPrim()
        self._links = {
            prim.GetDisplayName(): prim
            for prim in Usd.PrimRange(root)
            if prim.GetTypeName() == "Xform" and prim != root
        }
        self._rest = {prim.GetPath(): _pose_of(cache, prim) for prim in self._links.values()}
        self._joints = [
            self._read_joint(UsdPhysics.Joint(prim))
            for prim in self._stage.Traverse()
            if prim.IsA(UsdPhysics.Joint)
        ]

    @override
    def poses(self, joints: Mapping[str, float]) -> Poses:
        placed = dict(self._rest)
        moved = set()
        for joint in self._joints:  # parents first, as they were written
            origin = placed[joint.parent] if joint.parent else _ORIGIN
            turn, shift = _motion(joint.kind, joints.get(joint.name, 0.0))
            at = compose(compose(origin, joint.frame), (shift, turn))
            placed[joint.child] = compose(at, joint.back)
            moved.add(joint.child)
        for prim in self._links.values():  # frames of a rigid body move with it
            path, carrier = prim.GetPath(), prim.GetPath()
            while carrier not in moved and carrier.GetParentPath() in placed:
                carrier = carrier.GetParentPath()
            if carrier != path:
                offset = compose(inverse(self._rest[carrier]), self._rest[path])
                placed[path] = compose(placed[carrier], offset)
        return {name: placed[prim.GetPath()] for name, prim in self._links.items()}

    def _read_joint(self, joint) -> "_UsdJoint":
        (child,), parents = joint.GetBody1Rel().GetTargets(), joint.GetBody0Rel().GetTargets()
        kinds = {"revolute": self._physics.RevoluteJoint, "prismatic": self._physics.PrismaticJoint}
        return _UsdJoint(
            name=joint.GetPrim().GetDisplayName(),
            kind=next((name for name, kind in kinds.items() if joint.GetPrim().IsA(kind)), "fixed"),
            parent=parents[0] if parents else None,
            child=child,
            frame=_frame(joint.GetLocalPos0Attr(), joint.GetLocalRot0Attr()),
            back=inverse(_frame(joint.GetLocalPos1Attr(), joint.GetLocalRot1Attr())),
        )

    @override
    def inertials(self) -> dict[str, Inertia]:
        found = {}
        for name, prim in self._links.items():
            mass = self._physics.MassAPI(prim)
            if not prim.HasAPI(self._physics.MassAPI):
                found[name] = Inertia(0.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
                continue
            found[name] = Inertia(
                float(mass.GetMassAttr().Get()),
                np.array(mass.GetCenterOfMassAttr().Get()),
                _wxyz(mass.GetPrincipalAxesAttr().Get()),
                np.array(mass.GetDiagonalInertiaAttr().Get()),
            )
        return found


def _motion(kind: str, position: float) -> Frame:
    """Returns a joint's rotation (wxyz) and translation along the X axis of its frame."""
    if kind == "revolute":
        return np.array([np.cos(position / 2), np.sin(position / 2), 0.0, 0.0]), np.zeros(3)
    shift = position if kind == "prismatic" else 0.0
    return np.array([1.0, 0.0, 0.0, 0.0]), np.array([shift, 0.0, 0.0])


def _pose_of(cache, prim) -> Frame:
    matrix = cache.GetLocalToWorldTransform(prim)
    return np.array(matrix.ExtractTranslation()), _wxyz(matrix.ExtractRotationQuat())


def _frame(pos, rot) -> Frame:
    quat = _wxyz(rot.Get())
    return np.array(pos.Get(), np.float64), quat / np.linalg.norm(quat)


def _wxyz(quat) -> np.ndarray:
    return np.array([quat.GetReal(), *quat.GetImaginary()], np.float64)

"""Collision shapes of PhysX from geoms of a MuJoCo model."""

import mujoco
import numpy as np
from sapien import Pose, physx

from envs.core.errors import SimulatorError
from envs.mjcf.collision import hull_of
from envs.mjcf.link_tree import Frame, compose

Z_FROM_X = np.array([0.5**0.5, 0.0, -(0.5**0.5), 0.0])
"""Turns the x axis, along which PhysX's cylinders, capsules and planes point, to MuJoCo's z."""

SPHERE_POINTS = 128
"""Vertices of the hull that an ellipsoid becomes."""

_SHAPES = mujoco.mjtGeom


def pose_of(frame: Frame) -> Pose:
    """Returns a frame as SAPIEN's."""
    return Pose(frame[0].astype(np.float32), frame[1].astype(np.float32))


class ShapeFactory:
    """Makes the collision shapes of one model.

    Friction of two things that touch is the mean of both (PhysX's rule), where MuJoCo takes the larger.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._materials: dict[float, physx.PhysxMaterial] = {}
        self._excluded = _excluded(model)

    def make(self, geom: int, frame: Frame, group: int) -> physx.PhysxCollisionShape:
        """Makes a geom's shape.

        Args:
            geom: Its id.
            frame: Where it is in its link.
            group: Number of the tree; it keeps the pairs apart that the model excludes.

        Raises:
            SimulatorError: if PhysX has no such shape.
        """
        model = self._model
        slide, spin, _ = (float(value) for value in model.geom_friction[geom])
        material = self._materials.get(slide)
        if material is None:
            material = self._materials[slide] = physx.PhysxMaterial(slide, slide, 0.0)
        shape, turned = self._shape(geom, material)
        shape.local_pose = pose_of(compose(frame, (np.zeros(3), Z_FROM_X)) if turned else frame)
        # A geom that touches only as half of a pair has no bits of its own.
        kind, with_kind = int(model.geom_contype[geom]), int(model.geom_conaffinity[geom])
        if not kind and not with_kind:
            kind = with_kind = 1
        shape.set_collision_groups([kind, with_kind, self._excluded[model.geom_bodyid[geom]], group])
        if slide > 0.0:  # torsional friction, as that of a patch of this radius
            shape.min_patch_radius = shape.patch_radius = spin / slide
        return shape

    def _shape(self, geom: int, material: physx.PhysxMaterial) -> tuple[physx.PhysxCollisionShape, bool]:
        """Returns the shape, and whether it points along x where MuJoCo's points along z."""
        size = self._model.geom_size[geom]
        kind = int(self._model.geom_type[geom])
        if kind == _SHAPES.mjGEOM_PLANE:
            return physx.PhysxCollisionShapePlane(material), True
        if kind == _SHAPES.mjGEOM_BOX:
            return physx.PhysxCollisionShapeBox(size.astype(np.float32), material), False
        if kind == _SHAPES.mjGEOM_SPHERE:
            return physx.PhysxCollisionShapeSphere(float(size[0]), material), False
        if kind == _SHAPES.mjGEOM_CAPSULE:
            return physx.PhysxCollisionShapeCapsule(float(size[0]), float(size[1]), material), True
        if kind == _SHAPES.mjGEOM_CYLINDER:
            return physx.PhysxCollisionShapeCylinder(float(size[0]), float(size[1]), material), True
        if kind in (_SHAPES.mjGEOM_MESH, _SHAPES.mjGEOM_ELLIPSOID):
            points = (
                hull_of(self._model, geom)
                if kind == _SHAPES.mjGEOM_MESH
                else sphere_points(SPHERE_POINTS) * size
            )
            one = np.ones(3, np.float32)
            return physx.PhysxCollisionShapeConvexMesh(points.astype(np.float32), one, material), False
        name = self._model.geom(geom).name or f"number {geom}"
        raise SimulatorError(
            f"SAPIEN has no collision shape for the geom '{name}' ({_SHAPES(kind).name}). "
            "Take simulator=mujoco."
        )


def _excluded(model: mujoco.MjModel) -> np.ndarray:
    """Returns one bit per excluded pair of bodies, set in both, (nbody,)."""
    bits = np.zeros(model.nbody, np.int64)
    for index, signature in enumerate(model.exclude_signature[:31]):
        for body in (int(signature) >> 16, int(signature) & 0xFFFF):
            bits[body] |= 1 << index
    return bits


def sphere_points(count: int) -> np.ndarray:
    """Returns points all over the unit sphere, on a golden spiral, (count, 3)."""
    index = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * index / count, np.pi * (1.0 + 5.0**0.5) * index
    radius = np.sqrt(1.0 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)

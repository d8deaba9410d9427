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

    Args:
        model: The compiled model.
        groups: Words of each geom, (ngeom, 4), which say what touches what.
    """

    def __init__(self, model: mujoco.MjModel, groups: np.ndarray) -> None:
        self._model, self._groups = model, groups
        self._materials: dict[float, physx.PhysxMaterial] = {}

    def make(self, geom: int, frame: Frame) -> physx.PhysxCollisionShape:
        """Makes a geom's shape.

        Args:
            geom: Its id.
            frame: Where it is in its link.

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
        shape.set_collision_groups(self._groups[geom].tolist())
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


def sphere_points(count: int) -> np.ndarray:
    """Returns points all over the unit sphere, on a golden spiral, (count, 3)."""
    index = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * index / count, np.pi * (1.0 + 5.0**0.5) * index
    radius = np.sqrt(1.0 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)

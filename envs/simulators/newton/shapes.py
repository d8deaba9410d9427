"""Collision shapes of Newton from geoms of a MuJoCo model."""

from typing import Any

import mujoco
import newton
import numpy as np
import warp as wp

from envs.core.errors import SimulatorError
from envs.mjcf.collision import touching
from envs.mjcf.link_tree import Frame

_SHAPES = mujoco.mjtGeom


def transform(frame: Frame) -> Any:
    """Returns a frame as Warp's transform, whose quaternion ends with w."""
    (w, x, y, z), (px, py, pz) = (frame[1].tolist(), frame[0].tolist())
    return wp.transform(wp.vec3(px, py, pz), wp.quat(x, y, z, w))


def view(array: "wp.array | None") -> np.ndarray:
    """Returns an array of Newton's on the CPU as one that writes into it; nothing is copied."""
    assert array is not None, "a finalized model has it"
    return array.numpy()


class ShapeFactory:
    """Adds the geoms of one model to a builder, with their friction, impedance and contact pairs."""

    def __init__(self, model: mujoco.MjModel, builder: newton.ModelBuilder) -> None:
        self._model, self._builder = model, builder
        self._meshes: dict[int, newton.Mesh] = {}
        self._shapes: dict[int, int] = {}

    def add(self, geom: int, frame: Frame, link: int) -> None:
        """Adds a geom.

        Args:
            geom: Its id.
            frame: Where it is in its link.
            link: Newton's index of the link; -1 is the world.

        Raises:
            SimulatorError: if Newton has no such shape.
        """
        self._shapes[geom] = self._add(geom, frame, link)

    def keep_apart(self) -> None:
        """Enables only the contact pairs that MuJoCo has, once all shapes are added."""
        geoms = np.array(list(self._shapes), np.intp)
        touch = touching(self._model, geoms)
        for first, second in np.argwhere(~touch):
            if first < second:
                pair = self._shapes[int(geoms[first])], self._shapes[int(geoms[second])]
                self._builder.add_shape_collision_filter_pair(*pair)

    def _add(self, geom: int, frame: Frame, link: int) -> int:
        model, builder = self._model, self._builder
        slide, spin, roll = (float(value) for value in model.geom_friction[geom])
        common = {
            "xform": transform(frame),
            "cfg": newton.ModelBuilder.ShapeConfig(
                density=0.0,
                mu=slide,
                mu_torsional=spin,
                mu_rolling=roll,
                margin=float(model.geom_margin[geom]),
                gap=0.0,
                collision_filter_parent=False,
            ),
            "label": f"geom{geom}",
            "custom_attributes": {
                "mujoco:condim": int(model.geom_condim[geom]),
                "mujoco:geom_priority": int(model.geom_priority[geom]),
                "mujoco:geom_solimp": [float(value) for value in model.geom_solimp[geom]],
                "mujoco:solref": [float(value) for value in model.geom_solref[geom]],
                "mujoco:solref_mode": 1,
            },
        }
        size = [float(value) for value in model.geom_size[geom]]
        shape = int(model.geom_type[geom])
        if shape == _SHAPES.mjGEOM_PLANE:
            return builder.add_shape_plane(None, width=0.0, length=0.0, body=link, **common)
        if shape == _SHAPES.mjGEOM_BOX:
            return builder.add_shape_box(link, hx=size[0], hy=size[1], hz=size[2], **common)
        if shape == _SHAPES.mjGEOM_SPHERE:
            return builder.add_shape_sphere(link, radius=size[0], **common)
        if shape == _SHAPES.mjGEOM_CAPSULE:
            return builder.add_shape_capsule(link, radius=size[0], half_height=size[1], **common)
        if shape == _SHAPES.mjGEOM_CYLINDER:
            return builder.add_shape_cylinder(link, radius=size[0], half_height=size[1], **common)
        if shape == _SHAPES.mjGEOM_ELLIPSOID:
            return builder.add_shape_ellipsoid(link, rx=size[0], ry=size[1], rz=size[2], **common)
        if shape == _SHAPES.mjGEOM_MESH:
            return builder.add_shape_convex_hull(
                link, mesh=self._mesh(int(model.geom_dataid[geom])), **common
            )
        name = model.geom(geom).name or f"number {geom}"
        raise SimulatorError(
            f"Newton gets no collision shape for the geom '{name}' ({_SHAPES(shape).name}). "
            "Take simulator=mujoco."
        )

    def _mesh(self, mesh: int) -> newton.Mesh:
        if mesh not in self._meshes:
            model = self._model
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            face, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
            self._meshes[mesh] = newton.Mesh(
                np.asarray(model.mesh_vert[first : first + count], np.float32),
                np.asarray(model.mesh_face[face : face + faces], np.int32).ravel(),
                compute_inertia=False,
            )
        return self._meshes[mesh]


def check_pairs(model: mujoco.MjModel, theirs: mujoco.MjModel) -> None:
    """Compares the contact pairs with those of the Newton solver's own model.

    Newton encodes pairs in bit masks, which silently overflow when a scene has too many shapes.

    Args:
        model: The compiled scene.
        theirs: The solver's.

    Raises:
        SimulatorError: if a pair is not the same.
    """
    places = np.arange(theirs.ngeom)
    geoms = np.array([int(theirs.geom(i).name[4:].split("_")[0]) for i in places.tolist()], np.intp)
    wrong = np.argwhere(touching(model, geoms) != touching(theirs, places))
    if len(wrong):
        one, other = (model.geom(int(geoms[index])).name for index in wrong[0])
        raise SimulatorError(
            f"Newton confuses which of this scene's {len(geoms)} shapes touch, as '{one}' and "
            f"'{other}'. Take simulator=mujoco."
        )

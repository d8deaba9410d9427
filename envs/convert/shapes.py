"""Reads shapes and materials of a compiled MuJoCo model into :mod:`envs.convert.description`."""

import logging
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

from envs.convert.description import Material, Mesh, Shape
from envs.mjcf.geom_colors import image_of, rgba_of
from envs.rotations import conjugate, rotate

logger = logging.getLogger(__name__)

_GEOM = mujoco.mjtGeom
_KINDS = {
    int(_GEOM.mjGEOM_SPHERE): ("sphere", 1),
    int(_GEOM.mjGEOM_CAPSULE): ("capsule", 2),
    int(_GEOM.mjGEOM_CYLINDER): ("cylinder", 2),
    int(_GEOM.mjGEOM_BOX): ("box", 3),
}
_UNBOUNDED = (int(_GEOM.mjGEOM_PLANE), int(_GEOM.mjGEOM_HFIELD), int(_GEOM.mjGEOM_SDF))
_MESH, _ELLIPSOID = int(_GEOM.mjGEOM_MESH), int(_GEOM.mjGEOM_ELLIPSOID)

_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
_FLAT_TEXTURE = int(mujoco.mjtTexture.mjTEXTURE_2D)

_ELLIPSOID_SUBDIVISIONS = 3


class ShapeReader:
    """Reads geoms; shared meshes and materials are read once.

    Args:
        model: A compiled model.
        mesh_files: Mesh name to the file that it was read from, where there is one.

    Attributes:
        losses: What could not be read, one sentence each.
    """

    def __init__(self, model: mujoco.MjModel, mesh_files: Mapping[str, Path]) -> None:
        self._model = model
        self._files = mesh_files
        self._meshes: dict[tuple[int, float, float], Mesh] = {}
        self._hulls: dict[int, Mesh] = {}
        self._materials: dict[tuple, Material] = {}
        self._mesh_names: set[str] = set()
        self._material_names: set[str] = set()
        self.losses: list[str] = []
        self._shown_groups = _shown_groups(model)

    def visible(self, geom: int) -> bool:
        """Whether a geom is visual; collision geoms are not, where a model separates the two."""
        return self._rgba(geom)[3] > 0 and int(self._model.geom_group[geom]) in self._shown_groups

    def collides(self, geom: int) -> bool:
        """Whether a geom collides with anything."""
        return bool(self._model.geom_contype[geom] or self._model.geom_conaffinity[geom])

    def shape(self, geom: int, offset: np.ndarray, *, convex: bool) -> Shape | None:
        """Returns a geom in a frame at ``offset`` from its body's, or None if it is unbounded.

        Args:
            geom: Its id.
            offset: Position of the frame in the body, (3,), m.
            convex: Whether a mesh is replaced by its convex hull, as in MuJoCo's collisions.
        """
        model, kind = self._model, int(self._model.geom_type[geom])
        if kind in _UNBOUNDED:
            self._lose(f"A {_GEOM(kind).name.removeprefix('mjGEOM_').lower()} cannot be part of a robot.")
            return None
        pos, rot = model.geom_pos[geom] - offset, model.geom_quat[geom].copy()
        friction = float(model.geom_friction[geom, 0])
        if kind in _KINDS:
            name, count = _KINDS[kind]
            size = tuple(float(value) for value in model.geom_size[geom, :count])
            return Shape(name, size, pos, rot, self._material(geom, None, seen=not convex), friction=friction)  # pyright: ignore[reportArgumentType]
        if kind == _ELLIPSOID:
            mesh = self._ellipsoid(geom)
        elif convex:
            mesh = self._hull(int(model.geom_dataid[geom]))
        else:
            mesh = self._mesh(geom)
        return Shape("mesh", (), pos, rot, self._material(geom, mesh, seen=not convex), mesh, friction)

    def _mesh(self, geom: int) -> Mesh:
        model, index, material = self._model, int(self._model.geom_dataid[geom]), self._texture(geom)
        repeat = (1.0, 1.0)
        if material is not None:
            across, up = model.mat_texrepeat[model.geom_matid[geom]]
            repeat = (float(across), float(up))
        key = (index, *repeat)
        if key not in self._meshes:
            mesh = self._compiled(index, repeat)
            if mesh.uvs is None and material is not None:
                mesh = self._textured_twin(index, mesh) or mesh
            self._meshes[key] = mesh
        return self._meshes[key]

    def _compiled(self, index: int, repeat: tuple[float, float]) -> Mesh:
        model = self._model
        first, count = int(model.mesh_vertadr[index]), int(model.mesh_vertnum[index])
        faces = slice(
            int(model.mesh_faceadr[index]), int(model.mesh_faceadr[index] + model.mesh_facenum[index])
        )
        normal, normals = int(model.mesh_normaladr[index]), int(model.mesh_normalnum[index])
        uvs = None
        if (uv := int(model.mesh_texcoordadr[index])) >= 0:
            coordinates = model.mesh_texcoord[uv : uv + int(model.mesh_texcoordnum[index])] * repeat
            coordinates[:, 1] = 1.0 - coordinates[:, 1]  # MuJoCo's v points down in the image
            uvs = (coordinates, model.mesh_facetexcoord[faces].copy())
        return Mesh(
            name=_unique(_mesh_name(model, index), self._mesh_names),
            vertices=model.mesh_vert[first : first + count].astype(np.float64),
            faces=model.mesh_face[faces].copy(),
            normals=(
                model.mesh_normal[normal : normal + normals].copy(),
                model.mesh_facenormal[faces].copy(),
            ),
            uvs=uvs,
        )

    def _hull(self, index: int) -> Mesh:
        if index not in self._hulls:
            model = self._model
            first, count = int(model.mesh_vertadr[index]), int(model.mesh_vertnum[index])
            points = model.mesh_vert[first : first + count].astype(np.float64)
            name = _unique(f"{_mesh_name(model, index)}_hull", self._mesh_names)
            self._hulls[index] = convex_hull(name, points)
        return self._hulls[index]

    def _ellipsoid(self, geom: int) -> Mesh:
        import trimesh

        ball = trimesh.creation.icosphere(subdivisions=_ELLIPSOID_SUBDIVISIONS)
        vertices = np.asarray(ball.vertices) * self._model.geom_size[geom]
        return Mesh(_unique(f"ellipsoid_{geom}", self._mesh_names), vertices, np.asarray(ball.faces))

    def _textured_twin(self, index: int, mesh: Mesh) -> Mesh | None:
        """Returns the mesh of an .obj beside the mesh's file that has texture coordinates and fits it."""
        model, name = self._model, _mesh_name(self._model, index)
        path = self._files.get(name)
        twin = None if path is None or path.suffix == ".obj" else path.with_suffix(".obj")
        if twin is None or not twin.is_file():
            return None
        import trimesh

        loaded = trimesh.load_mesh(twin, process=False)
        coordinates = getattr(loaded.visual, "uv", None)
        if coordinates is None:
            return None
        moved = np.asarray(loaded.vertices) * model.mesh_scale[index] - model.mesh_pos[index]
        vertices = rotate(conjugate(model.mesh_quat[index]), moved)
        ours, theirs = np.ptp(mesh.vertices, axis=0), np.ptp(vertices, axis=0)
        gap = max(np.abs(ours - theirs).max(), np.abs(mesh.vertices.min(0) - vertices.min(0)).max())
        if gap > 0.01 * ours.max():
            self._lose(
                f"{twin.name} has another shape than {path.name if path else name}, so its texture is unused."
            )
            return None
        faces = np.asarray(loaded.faces)
        return Mesh(mesh.name, vertices, faces, uvs=(np.asarray(coordinates), faces))

    def _texture(self, geom: int) -> int | None:
        material = int(self._model.geom_matid[geom])
        if material < 0 or (texture := int(self._model.mat_texid[material, _RGB])) < 0:
            return None
        return texture

    def _material(self, geom: int, mesh: Mesh | None, *, seen: bool) -> Material:
        model, rgba, texture = self._model, self._rgba(geom), self._texture(geom)
        image = None
        if texture is not None:
            image = image_of(model, texture)
            if not self._can_lie_on(mesh, texture):
                if seen:
                    self._lose(self._why_not(geom, mesh, texture))
                mean = image.reshape(-1, 3).mean(0) / 255.0
                rgba, image = (*(np.array(rgba[:3]) * mean).tolist(), rgba[3]), None
        material = int(model.geom_matid[geom])
        key = (rgba, material if image is not None else -1)
        if key not in self._materials:
            name = model.material(material).name if material >= 0 else "colour"
            rough, metal = 0.7, 0.0
            if material >= 0:
                rough = float(np.clip(model.mat_roughness[material], -1, 1))
                metal = float(np.clip(model.mat_metallic[material], -1, 1))
            self._materials[key] = Material(
                name=_unique(name or "material", self._material_names),
                rgba=rgba,
                image=image,
                roughness=rough if rough >= 0 else 0.7,
                metallic=max(metal, 0.0),
            )
        return self._materials[key]

    def _can_lie_on(self, mesh: Mesh | None, texture: int) -> bool:
        has_coordinates = mesh is not None and mesh.uvs is not None
        return has_coordinates and int(self._model.tex_type[texture]) == _FLAT_TEXTURE

    def _why_not(self, geom: int, mesh: Mesh | None, texture: int) -> str:
        name = self._model.material(int(self._model.geom_matid[geom])).name
        if int(self._model.tex_type[texture]) != _FLAT_TEXTURE:
            return f"Material '{name}' has a cube map, which a mesh cannot have: its mean colour is used."
        what = f"mesh '{mesh.name}'" if mesh is not None else "a primitive shape"
        return (
            f"The image of material '{name}' cannot be aligned on {what}, which has no texture "
            "coordinates: its mean colour is used."
        )

    def _rgba(self, geom: int) -> tuple[float, float, float, float]:
        colour = rgba_of(self._model, np.array([geom]))[0]
        red, green, blue, alpha = (round(float(value), 6) for value in colour)
        return red, green, blue, alpha

    def _lose(self, sentence: str) -> None:
        if sentence not in self.losses:
            self.losses.append(sentence)


def convex_hull(name: str, points: np.ndarray) -> Mesh:
    """Returns the convex hull of points (V, 3), with faces oriented outwards."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError:  # flat or thin: jitter the points so that the hull has a volume
        spread = np.concatenate([points - 1e-6, points + 1e-6])
        hull = ConvexHull(spread, qhull_options="QJ")
        points = spread
    numbers = np.full(len(points), -1)
    numbers[hull.vertices] = np.arange(len(hull.vertices))
    corners = points[hull.vertices]
    faces = numbers[hull.simplices]
    first, second, third = (corners[faces[:, column]] for column in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(second - first, third - first), hull.equations[:, :3]) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return Mesh(name, corners, faces)


def _shown_groups(model: mujoco.MjModel) -> set[int]:
    """Visual geom groups: those without collisions, or the first three if there are none."""
    seen_only = (model.geom_contype == 0) & (model.geom_conaffinity == 0)
    groups = {int(group) for group in model.geom_group[seen_only & (model.geom_rgba[:, 3] > 0)]}
    return groups or {0, 1, 2}


def _mesh_name(model: mujoco.MjModel, index: int) -> str:
    return model.mesh(index).name or f"mesh{index}"


def _unique(name: str, taken: set[str]) -> str:
    """Returns the name, or the first of name_2, name_3, … that is free, and reserves it."""
    free, number = name, 2
    while free in taken:
        free, number = f"{name}_{number}", number + 1
    taken.add(free)
    return free

"""SAPIEN visuals of a MuJoCo model's geoms."""

from typing import Any

import mujoco
import numpy as np
import sapien
from sapien import Pose

from envs.core.errors import SimulatorError
from envs.mjcf.geom_colors import image_of, rgba_of, texture_id
from envs.mjcf.model import OBJECT_MATERIAL
from envs.rotations import multiply
from envs.scenario import SURFACES
from envs.simulators.plane import plane_mesh
from envs.simulators.sapien.shapes import Z_FROM_X, sphere_points

_SHAPES = mujoco.mjtGeom


class VisualFactory:
    """Makes the shapes of one model.

    Attributes:
        surfaces: Surface to its material.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        white = sapien.render.RenderTexture2D(np.full((2, 2, 4), 255, np.uint8), "R8G8B8A8Unorm")
        self.surfaces: dict[str, Any] = {}
        for surface in SURFACES:
            self.surfaces[surface] = sapien.render.RenderMaterial()
            self.surfaces[surface].set_base_color_texture(white)
        self._of_material = {model.material(surface).id: surface for surface in SURFACES}
        self._reflecting: list[Any] = []
        self._reflection = (0.6, 0.3, 0.0)
        self._materials: dict[tuple, Any] = {}

    def reflect(self, reflection: tuple[float, float, float]) -> None:
        """Gives objects and robots a roughness, a strength of highlights and a share of metal."""
        self._reflection = reflection
        for material in self._reflecting:
            material.roughness, material.specular, material.metallic = reflection

    def make(self, geom: int, copies_per_metre: float = 1.0, *, fresh: bool = False):
        """Makes a geom's shape, in the frame of its body.

        Args:
            geom: Its id.
            copies_per_metre: How often a surface's image is repeated.
            fresh: Its material is neither shared nor cached: for visuals rebuilt at each change.

        Raises:
            SimulatorError: if SAPIEN has no such shape.
        """
        model = self._model
        kind, size = int(model.geom_type[geom]), model.geom_size[geom]
        pose = Pose(model.geom_pos[geom], model.geom_quat[geom])
        surface = self._of_material.get(int(model.geom_matid[geom]))
        if surface is not None:
            shape = _surface(kind, size, copies_per_metre, self.surfaces[surface])
        elif kind in (_SHAPES.mjGEOM_CAPSULE, _SHAPES.mjGEOM_CYLINDER):
            pose = Pose(model.geom_pos[geom], multiply(np.array(model.geom_quat[geom]), Z_FROM_X))
            capsule = kind == _SHAPES.mjGEOM_CAPSULE
            make = sapien.render.RenderShapeCapsule if capsule else sapien.render.RenderShapeCylinder
            shape = make(float(size[0]), float(size[1]), self._material(geom, fresh))
        elif kind == _SHAPES.mjGEOM_SPHERE:
            shape = sapien.render.RenderShapeSphere(float(size[0]), self._material(geom, fresh))
        elif kind == _SHAPES.mjGEOM_BOX:
            shape = sapien.render.RenderShapeBox(size.astype(np.float32), self._material(geom, fresh))
        elif kind == _SHAPES.mjGEOM_PLANE:
            shape = _mesh(*plane_mesh(size), self._material(geom, fresh))
        elif kind == _SHAPES.mjGEOM_MESH:
            shape = _mesh(*self._mesh_of(geom), self._material(geom, fresh))
        elif kind == _SHAPES.mjGEOM_ELLIPSOID:
            shape = _mesh(*_ellipsoid(size), self._material(geom, fresh))
        else:
            name = model.geom(geom).name or f"number {geom}"
            raise SimulatorError(
                f"renderer=sapien cannot render the geom '{name}' ({_SHAPES(kind).name}). Take renderer=warp."
            )
        shape.local_pose = pose
        return shape

    def _material(self, geom: int, fresh: bool):
        model, index = self._model, int(self._model.geom_matid[geom])
        texture = texture_id(model, geom)
        rgba = tuple(rgba_of(model, np.array([geom]))[0].tolist())
        own = -1 if index < 0 or index == model.material(OBJECT_MATERIAL).id else index
        key = (rgba, texture, own)
        if fresh or key not in self._materials:
            material = sapien.render.RenderMaterial(base_color=list(rgba))
            material.roughness, material.specular, material.metallic = self._reflection
            if texture >= 0:
                material.set_base_color_texture(self._texture(texture, rgba))
            if own >= 0:
                material.roughness = float(np.clip(1.0 - model.mat_shininess[own], 0.05, 1.0))
                material.specular = float(np.clip(model.mat_specular[own], 0.0, 1.0))
            if fresh:
                return material
            if own < 0:
                self._reflecting.append(material)
            self._materials[key] = material
        return self._materials[key]

    def _texture(self, texture: int, rgba: tuple[float, ...]):
        pixels = image_of(self._model, texture)
        image = np.full((*pixels.shape[:2], 4), 255, np.uint8)
        image[..., :3] = np.rint(pixels * np.asarray(rgba[:3]))
        return sapien.render.RenderTexture2D(image, "R8G8B8A8Unorm", srgb=False)

    def _mesh_of(self, geom: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Returns vertices, triangles, normals and texture coordinates of a mesh, one vertex per corner."""
        model, mesh = self._model, int(self._model.geom_dataid[geom])
        faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
        corners = model.mesh_face[faces].ravel()
        vertices = model.mesh_vert[model.mesh_vertadr[mesh] + corners]
        normals = model.mesh_normal[model.mesh_normaladr[mesh] + model.mesh_facenormal[faces].ravel()]
        uvs = np.zeros((len(corners), 2))
        if model.mesh_texcoordadr[mesh] >= 0:
            uvs = model.mesh_texcoord[model.mesh_texcoordadr[mesh] + model.mesh_facetexcoord[faces].ravel()]
        return vertices, np.arange(len(corners)).reshape(-1, 3), normals, uvs


def _surface(kind: int, size: np.ndarray, copies_per_metre: float, material):
    vertices, triangles, normals, metres = plane_mesh(size) if kind == _SHAPES.mjGEOM_PLANE else _box(size)
    return _mesh(vertices, triangles, normals, copies_per_metre * metres, material)


def _mesh(vertices, triangles, normals, uvs, material):
    return sapien.render.RenderShapeTriangleMesh(
        np.ascontiguousarray(vertices, np.float32),
        np.ascontiguousarray(triangles, np.uint32),
        np.ascontiguousarray(normals, np.float32),
        np.ascontiguousarray(uvs, np.float32),
        material,
    )


def _box(half: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Six sides with texture coordinates in metres."""
    parts = []
    for axis in range(3):
        first, second = ((1, 2), (0, 2), (0, 1))[axis]
        for sign in (-1.0, 1.0):
            vertices, normals = np.zeros((4, 3)), np.zeros((4, 3))
            corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half[[first, second]]
            vertices[:, first], vertices[:, second] = corners.T
            vertices[:, axis], normals[:, axis] = sign * half[axis], sign
            parts.append((vertices, normals, corners + half[[first, second]]))
    vertices, normals, uvs = (np.concatenate(group) for group in zip(*parts, strict=True))
    triangles = np.concatenate([np.array([(0, 1, 2), (0, 2, 3)]) + 4 * side for side in range(6)])
    return vertices, _outward(vertices, triangles, normals), normals, uvs


def _ellipsoid(size: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    from scipy.spatial import ConvexHull

    points = sphere_points(512)
    triangles = _outward(points, ConvexHull(points).simplices, points)
    normals = points / size
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return points * size, triangles, normals, np.zeros((len(points), 2))


def _outward(vertices: np.ndarray, triangles: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Returns the triangles in the order in which their normals point outwards."""
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), normals[triangles[:, 0]]) < 0.0
    return np.where(inward[:, None], triangles[:, ::-1], triangles)

"""Geoms of a MuJoCo model as triangles for Bullet's rasterizer."""

from dataclasses import dataclass

import mujoco
import numpy as np

from envs.core.errors import SimulatorError
from envs.simulators.plane import plane_mesh

_GEOM = mujoco.mjtGeom
_RINGS, _SEGMENTS = 12, 24


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """A visible shape in its geom's frame.

    Attributes:
        vertices: (V, 3), m.
        faces: (F, 3).
        normals: (V, 3).
        uvs: Texture coordinates (V, 2), v pointing up in the image; of a plane's and a box's sides metres
            from a corner.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray


def triangles_of(model: mujoco.MjModel, geom: int) -> Triangles:
    """Returns the triangles of a geom.

    Raises:
        SimulatorError: if it is of a kind that has none.
    """
    kind, size = int(model.geom_type[geom]), np.array(model.geom_size[geom])
    if kind == _GEOM.mjGEOM_MESH:
        return _mesh(model, int(model.geom_dataid[geom]))
    if kind == _GEOM.mjGEOM_PLANE:
        return Triangles(*plane_mesh(size))
    if kind == _GEOM.mjGEOM_BOX:
        return _box(size)
    profiles = {
        _GEOM.mjGEOM_SPHERE: lambda: _round_profile(size[0], 0.0),
        _GEOM.mjGEOM_ELLIPSOID: lambda: _round_profile(1.0, 0.0),
        _GEOM.mjGEOM_CAPSULE: lambda: _round_profile(size[0], size[1]),
        _GEOM.mjGEOM_CYLINDER: lambda: _cylinder_profile(size[0], size[1]),
    }
    if kind not in profiles:
        name = model.geom(geom).name or f"number {geom}"
        raise SimulatorError(
            f"renderer=pybullet cannot render the geom '{name}' ({_GEOM(kind).name}). Take renderer=warp."
        )
    turned = _turned(*profiles[_GEOM(kind)]())
    if kind != _GEOM.mjGEOM_ELLIPSOID:
        return turned
    normals = turned.normals / size
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Triangles(turned.vertices * size, turned.faces, normals, turned.uvs)


def _mesh(model: mujoco.MjModel, mesh: int) -> Triangles:
    """A mesh's corners, each combination of vertex, normal and texture coordinates once."""
    faces = slice(int(model.mesh_faceadr[mesh]), int(model.mesh_faceadr[mesh] + model.mesh_facenum[mesh]))
    has_uvs = int(model.mesh_texcoordadr[mesh]) >= 0
    columns = [model.mesh_face[faces], model.mesh_facenormal[faces]]
    columns.append(model.mesh_facetexcoord[faces] if has_uvs else np.zeros_like(columns[0]))
    corners = np.stack(columns, axis=-1).reshape(-1, 3)
    unique, index = np.unique(corners, axis=0, return_inverse=True)
    vertices = model.mesh_vert[int(model.mesh_vertadr[mesh]) + unique[:, 0]]
    normals = model.mesh_normal[int(model.mesh_normaladr[mesh]) + unique[:, 1]]
    uvs = np.zeros((len(unique), 2))
    if has_uvs:
        uvs = model.mesh_texcoord[int(model.mesh_texcoordadr[mesh]) + unique[:, 2]].astype(np.float64)
        uvs[:, 1] = 1.0 - uvs[:, 1]
    return Triangles(vertices, index.reshape(-1, 3), normals, uvs)


def _box(half: np.ndarray) -> Triangles:
    sides = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        for sign in (-1.0, 1.0):
            corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])[:: int(sign)] * half[[first, second]]
            vertices, normals = np.zeros((4, 3)), np.zeros((4, 3))
            vertices[:, [first, second]], vertices[:, axis] = corners, sign * half[axis]
            normals[:, axis] = sign
            sides.append((vertices, normals, corners + half[[first, second]]))
    vertices, normals, uvs = (np.concatenate(parts) for parts in zip(*sides, strict=True))
    faces = np.concatenate([np.array([(0, 1, 2), (0, 2, 3)]) + 4 * side for side in range(6)])
    return Triangles(vertices, faces, normals, uvs)


def _round_profile(radius: float, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals (n, 2), radius and height, from the bottom of a sphere or capsule to its top."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, 2 * _RINGS)
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = radius * normals
    points[:, 1] += np.where(angles < 0, -half, half)
    return points, normals


def _cylinder_profile(radius: float, half: float) -> tuple[np.ndarray, np.ndarray]:
    points = np.array(
        [(0, -half), (radius, -half), (radius, -half), (radius, half), (radius, half), (0, half)]
    )
    return points, np.array([(0.0, -1.0), (0, -1), (1, 0), (1, 0), (0, 1), (0, 1)])


def _turned(points: np.ndarray, normals: np.ndarray) -> Triangles:
    """Turns a profile about z."""
    angles = np.linspace(0.0, 2.0 * np.pi, _SEGMENTS + 1)
    round_ = np.stack([np.cos(angles), np.sin(angles)], axis=1)  # (S, 2)

    def around(profile: np.ndarray) -> np.ndarray:
        flat = profile[:, None, :1] * round_[None]
        height = np.broadcast_to(profile[:, None, 1:], (*flat.shape[:2], 1))
        return np.concatenate([flat, height], axis=-1).reshape(-1, 3)

    rows, columns = np.meshgrid(np.arange(len(points) - 1), np.arange(_SEGMENTS), indexing="ij")
    first = (rows * (_SEGMENTS + 1) + columns).ravel()
    above = first + _SEGMENTS + 1
    faces = np.concatenate(
        [np.stack([first, first + 1, above + 1], 1), np.stack([first, above + 1, above], 1)]
    )
    uvs = np.stack(np.meshgrid(np.linspace(0, 1, len(points)), angles / (2 * np.pi), indexing="ij"), -1)
    return Triangles(around(points), faces, around(normals), uvs.reshape(-1, 2)[:, ::-1].copy())

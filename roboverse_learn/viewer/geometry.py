"""Triangle meshes of the visual geoms of a compiled scene, with their colours and textures."""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from envs.mjcf.geom_colors import image_of, rgba_of, surfaces_of, texture_id
from envs.mjcf.meshes import VISUAL_GROUP
from envs.mjcf.objects import SCENE_GROUP
from envs.scenario import Appearance, ScenarioCfg, SurfaceMaterial
from envs.simulators.base import TextureSource
from envs.simulators.mujoco.render import Stage, texture_of

_GEOM = mujoco.mjtGeom
_LEAST_SIZE_M = 0.005
"""Smaller geoms of the world are unused slots of its furniture."""


@dataclass(frozen=True, slots=True)
class GeomMesh:
    """A geom as triangles in its body's frame.

    Attributes:
        geom: Its id.
        vertices: (V, 3), m.
        triangles: (T, 3) rows of ``vertices``.
        normals: (V, 3) unit vectors.
        rgba: Colour, 0 to 1; with a texture, its factor.
        uvs: Texture coordinates (V, 2), or None.
        texture: Image (H, W, 3) uint8, or None.
    """

    geom: int
    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    rgba: tuple[float, ...]
    uvs: np.ndarray | None = None
    texture: np.ndarray | None = None


def visible_meshes(
    stage: Stage, scenario: ScenarioCfg, appearance: Appearance, textures: TextureSource | None
) -> Iterator[GeomMesh]:
    """Yields the visual geoms of a stage that was posed with an appearance.

    Walls have their inner faces alone, so that one sees into the room from outside.
    """
    model = stage.model
    surfaces = surfaces_of(model)
    for geom in range(model.ngeom):
        rgba = tuple(rgba_of(model, np.array([geom]))[0].tolist())
        if int(model.geom_group[geom]) not in (VISUAL_GROUP, SCENE_GROUP) or rgba[3] == 0.0:
            continue
        if model.geom_bodyid[geom] == 0 and 0 < model.geom_size[geom].max() < _LEAST_SIZE_M:
            continue
        found = _triangles(model, geom)
        if found is None:
            continue
        vertices, triangles, normals, uvs = found
        texture = None if uvs is None else _image(model, geom)
        surface = surfaces.get(geom)
        if surface is not None:
            looks = appearance.materials.get(surface) or scenario.appearance.materials.get(surface)
            material = looks or SurfaceMaterial()
            uvs, texture = _flat_uvs(vertices, normals) / material.size_m, None
            if material.texture is not None:
                texture = texture_of(material.texture, textures)
            rgba = (*material.rgb, 1.0)
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        turn = rotation.reshape(3, 3).T
        vertices, normals = vertices @ turn + model.geom_pos[geom], normals @ turn
        if surface == "wall":
            corners = triangles[:, 0]
            inner = np.einsum("ij,ij->i", normals[corners], vertices[corners] * (1, 1, 0)) < 0
            triangles = triangles[inner]
        yield GeomMesh(geom, vertices, triangles, normals, rgba, uvs, texture)


def _triangles(
    model: mujoco.MjModel, geom: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None] | None:
    """Returns vertices, triangles, normals and texture coordinates in the geom's frame.

    None for what has no triangles here: height fields and distance fields.
    """
    import trimesh

    kind, size = _GEOM(int(model.geom_type[geom])), model.geom_size[geom]
    if kind == _GEOM.mjGEOM_MESH:
        return _of_mesh(model, int(model.geom_dataid[geom]))
    if kind == _GEOM.mjGEOM_PLANE:
        x, y = np.where(size[:2] > 0.0, size[:2], 10.0)
        vertices = np.array([(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)])
        return vertices, np.array([(0, 1, 2), (0, 2, 3)]), np.tile([0.0, 0.0, 1.0], (4, 1)), None
    if kind == _GEOM.mjGEOM_BOX:
        shape = trimesh.creation.box(2 * size)
        shape.unmerge_vertices()
    elif kind == _GEOM.mjGEOM_CYLINDER:
        shape = trimesh.creation.cylinder(size[0], 2 * size[1])
        shape.unmerge_vertices()
    elif kind == _GEOM.mjGEOM_CAPSULE:
        shape = trimesh.creation.capsule(height=2 * size[1], radius=size[0])
    elif kind in (_GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_ELLIPSOID):
        shape = trimesh.creation.icosphere(subdivisions=3)
        shape.apply_scale(size if kind == _GEOM.mjGEOM_ELLIPSOID else size[0])
    else:
        return None
    return np.asarray(shape.vertices), np.asarray(shape.faces), np.asarray(shape.vertex_normals), None


def _of_mesh(
    model: mujoco.MjModel, mesh: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
    """Returns a mesh with one vertex per corner of a triangle, for each corner has a normal of its own."""
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    corners = model.mesh_face[faces].ravel()
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] + corners]
    normals = model.mesh_normal[model.mesh_normaladr[mesh] + model.mesh_facenormal[faces].ravel()]
    uvs = None
    if model.mesh_texcoordadr[mesh] >= 0:
        uvs = model.mesh_texcoord[model.mesh_texcoordadr[mesh] + model.mesh_facetexcoord[faces].ravel()]
    return vertices, np.arange(len(corners)).reshape(-1, 3), normals, uvs


def _image(model: mujoco.MjModel, geom: int) -> np.ndarray | None:
    texture = texture_id(model, geom)
    return None if texture < 0 else image_of(model, texture)


def _flat_uvs(vertices: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Returns coordinates in metres (V, 2) along the two axes that each face spans."""
    away = np.abs(normals).argmax(axis=1)
    first, second = np.array([1, 0, 0])[away], np.array([2, 2, 1])[away]
    rows = np.arange(len(vertices))
    return np.stack([vertices[rows, first], vertices[rows, second]], axis=1)

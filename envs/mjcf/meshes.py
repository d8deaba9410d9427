"""Visual meshes, merged by colour and simplified once, then cached.

Render time grows with the number of triangles and of geoms. robosuite's Panda has 149,000 triangles in
60 geoms; an image of 256 pixels shows a tenth of them.
"""

import functools
import hashlib
import json
import logging
import zipfile
from pathlib import Path

import mujoco
import numpy as np

from envs.core.assets import cache_dir
from envs.core.atomic import atomic_path
from envs.rotations import rotate

logger = logging.getLogger(__name__)

VISUAL_GROUP = 1
"""Geom group of the robots' visual meshes. Group 0 holds collision geometry, which is never rendered."""

_VERSION = 4


def simplify_visuals(spec: mujoco.MjSpec, folder: Path, max_faces_per_body: int) -> None:
    """Replaces each body's untextured visual meshes by one simplified mesh per colour, in place.

    Args:
        spec: A robot's model, before it is attached to a scene.
        folder: The folder that mesh files are relative to.
        max_faces_per_body: Triangles that the colours of a body share, by how many they have.
    """
    meshes = {mesh.name: mesh for mesh in spec.meshes}
    materials = {material.name: material for material in spec.materials}
    replaced = set()
    for body in spec.bodies:
        groups: dict[tuple[float, ...], list] = {}
        for geom in body.geoms:
            if _is_plain_visual(geom, materials):
                groups.setdefault(_rgba(geom, materials), []).append(geom)
        # A file's size grows with its triangles, and needs no reading.
        sizes = {
            rgba: sum((folder / meshes[geom.meshname].file).stat().st_size for geom in geoms)
            for rgba, geoms in groups.items()
        }
        for index, (rgba, geoms) in enumerate(sorted(groups.items())):
            parts = [(folder / meshes[g.meshname].file, g) for g in geoms]
            budget = max(64, max_faces_per_body * sizes[rgba] // sum(sizes.values()))
            vertices, faces = _merged(parts, meshes, budget)
            name = f"{body.name}_visual_{index}"
            # A mesh without a volume is a shell, and so is what it is merged to.
            inertia = meshes[geoms[0].meshname].inertia
            spec.add_mesh(name=name, uservert=vertices.ravel(), userface=faces.ravel(), inertia=inertia)
            for geom in geoms:
                replaced.add(geom.meshname)
                spec.delete(geom)
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                name=name,
                meshname=name,
                rgba=rgba,
                contype=0,
                conaffinity=0,
                group=VISUAL_GROUP,
                mass=0.0,
            )
    still_used = {geom.meshname for body in spec.bodies for geom in body.geoms}
    for name in replaced - still_used:
        spec.delete(meshes[name])


def _is_plain_visual(geom, materials) -> bool:
    if geom.type != mujoco.mjtGeom.mjGEOM_MESH or geom.group != VISUAL_GROUP or geom.contype:
        return False
    return not (geom.material and any(materials[geom.material].textures))


def _rgba(geom, materials) -> tuple[float, ...]:
    source = materials[geom.material].rgba if geom.material else geom.rgba
    return tuple(round(float(value), 4) for value in source)


def _merged(parts, meshes, budget: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices (V, 3) float32 in the body's frame and faces (F, 3) int32."""
    digest = hashlib.sha256(json.dumps([_VERSION, budget]).encode())
    for path, geom in parts:
        digest.update(content_digest(path))
        digest.update(np.concatenate([geom.pos, geom.quat, meshes[geom.meshname].scale]).tobytes())
    cached = cache_dir("meshes") / f"{digest.hexdigest()[:32]}.npz"
    stored = _stored(cached)
    if stored is not None:
        return stored
    vertices, faces = _simplified(*_concatenated(parts, meshes), budget)
    with atomic_path(cached) as temporary, temporary.open("wb") as file:
        np.savez(file, vertices=vertices, faces=faces)
    return vertices, faces


def content_digest(path: Path) -> bytes:
    """Returns the hash of a file's content."""
    facts = path.stat()
    return _digest(path, facts.st_size, facts.st_mtime_ns)


@functools.cache
def _digest(path: Path, _size: int, _changed_ns: int) -> bytes:
    """Returns the hash of a file's content, read again only where its size or time is another."""
    return hashlib.sha256(path.read_bytes()).digest()


def _stored(path: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """Returns a cached mesh, or None where there is none that can be read: it can be made again."""
    if not path.is_file():
        return None
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return stored["vertices"], stored["faces"]
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile) as error:
        logger.warning("The cached mesh %s cannot be read (%s); it is made again.", path, error)
        return None


def _concatenated(parts, meshes) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    vertices, faces, offset = [], [], 0
    for path, geom in parts:
        mesh = trimesh.load_mesh(path)
        # Files repeat a vertex for every normal; left apart, its faces would drift from each other.
        mesh.merge_vertices(merge_norm=True, merge_tex=True)
        points = np.asarray(mesh.vertices) * meshes[geom.meshname].scale
        vertices.append(rotate(np.asarray(geom.quat), points) + geom.pos)
        faces.append(np.asarray(mesh.faces) + offset)
        offset += len(points)
    return np.concatenate(vertices), np.concatenate(faces)


def _simplified(vertices, faces, budget: int) -> tuple[np.ndarray, np.ndarray]:
    import fast_simplification

    vertices, faces = vertices.astype(np.float32), faces.astype(np.int32)
    if len(faces) > budget:
        vertices, faces = fast_simplification.simplify(vertices, faces, target_count=budget)[:2]
    keep = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 0] != faces[:, 2])
    return vertices.astype(np.float32), faces[keep].astype(np.int32)

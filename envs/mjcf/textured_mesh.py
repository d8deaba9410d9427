"""Meshes with texture coordinates: read, simplified, and written for MuJoCo.

Shapes: V vertices, F triangles.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from envs.core.errors import ConfigError

_HEADER = 16
"""Bytes of a .msh file's header: numbers of vertices, normals, texture coordinates and faces, int32."""


@dataclass(frozen=True, slots=True, eq=False)
class TexturedMesh:
    """A triangle mesh.

    Attributes:
        vertices: (V, 3) float32, m.
        faces: Indices of vertices, (F, 3) int32.
        uv: Texture coordinates in MuJoCo's convention, (V, 2) float32, or None.
        normals: Normals, (V, 3) float32, or None: MuJoCo then computes them.
    """

    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray | None = None
    normals: np.ndarray | None = None

    @classmethod
    def read(cls, path: Path) -> "TexturedMesh":
        """Reads a file that MuJoCo reads: ``.msh``, or ``.obj`` and ``.stl``.

        Raises:
            ConfigError: It is no mesh.
        """
        try:
            return _read_msh(path) if path.suffix.lower() == ".msh" else _read_other(path)
        except (OSError, ValueError, IndexError, KeyError) as error:
            raise ConfigError(f"The mesh {path} cannot be read: {error}.") from error

    def welded(self) -> "TexturedMesh":
        """Returns the mesh with one vertex for each place and texture coordinate."""
        points = self.vertices if self.uv is None else np.concatenate([self.vertices, self.uv], 1)
        scale = float(np.abs(self.vertices).max(initial=1e-9))
        steps = np.full(points.shape[1], scale * 1e-6)
        steps[3:] = 1e-6
        rounded = np.round(points / steps)
        order = np.lexsort(rounded.T[::-1])  # as np.unique sorts rows, but faster
        begins = np.ones(len(order), bool)
        begins[1:] = (rounded[order[1:]] != rounded[order[:-1]]).any(1)
        first = order[begins]
        inverse = np.empty(len(order), np.int32)
        inverse[order] = np.cumsum(begins) - 1
        faces = inverse[self.faces]
        uv = None if self.uv is None else self.uv[first]
        return TexturedMesh(self.vertices[first], _proper(faces), uv)

    def simplified(self, budget: int) -> "TexturedMesh":
        """Returns a mesh of at most about ``budget`` triangles, without texture coordinates if it has fewer.

        Vertices of one place are one, so that no seam opens; see :mod:`envs.mjcf.baking` for the texture.
        """
        import fast_simplification

        if len(self.faces) <= budget:
            return self.welded()
        mesh = TexturedMesh(self.vertices, self.faces).welded()
        if len(mesh.faces) <= budget:
            return mesh
        vertices, faces = fast_simplification.simplify(mesh.vertices, mesh.faces, target_count=budget)[:2]
        if len(faces) > 1.5 * budget:  # a mesh of many loose pieces resists
            vertices, faces = fast_simplification.simplify(
                vertices.astype(np.float64), faces.astype(np.int32), target_count=budget, agg=10
            )[:2]
        return TexturedMesh(vertices.astype(np.float32), _proper(faces.astype(np.int32)))

    def msh(self) -> bytes:
        """Returns the content of a ``.msh`` file."""
        uv = np.zeros((0, 2), np.float32) if self.uv is None else self.uv
        normals = np.zeros((0, 3), np.float32) if self.normals is None else self.normals
        header = np.array([len(self.vertices), len(normals), len(uv), len(self.faces)], "<i4")
        parts = (header, *(np.ascontiguousarray(values, "<f4") for values in (self.vertices, normals, uv)))
        return b"".join(part.tobytes() for part in parts) + self.faces.astype("<i4").tobytes()


def box_mesh(half: np.ndarray, repeat_per_m: tuple[float, float]) -> TexturedMesh:
    """Returns a box whose texture repeats on each side, from the side's corner.

    Args:
        half: Half sizes, m, (3,).
        repeat_per_m: Copies of the texture in a metre, across and up.
    """
    vertices, uv, faces = [], [], []
    for axis in range(3):
        across, up = [other for other in range(3) if other != axis]
        for side in (-1.0, 1.0):
            corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], float)
            points = np.empty((4, 3))
            points[:, axis] = side * half[axis]
            points[:, [across, up]] = corners * half[[across, up]]
            uv.append((corners + 1.0) * half[[across, up]] * repeat_per_m)
            order = [(0, 1, 2), (0, 2, 3)] if (side > 0) == (axis != 1) else [(0, 2, 1), (0, 3, 2)]
            faces += [tuple(len(vertices) * 4 + corner for corner in face) for face in order]
            vertices.append(points)
    return TexturedMesh(
        np.concatenate(vertices).astype(np.float32),
        np.array(faces, np.int32),
        np.concatenate(uv).astype(np.float32),
    )


def _proper(faces: np.ndarray) -> np.ndarray:
    """Drops triangles that have a vertex twice."""
    keep = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 0] != faces[:, 2])
    return faces[keep]


def _read_msh(path: Path) -> TexturedMesh:
    data = path.read_bytes()
    if len(data) < _HEADER:
        raise ValueError("it is shorter than its header")
    vertices, normals, texcoords, faces = np.frombuffer(data, "<i4", 4).tolist()
    sizes = (3 * vertices, 3 * normals, 2 * texcoords, 3 * faces)
    if min(sizes) < 0 or len(data) != _HEADER + 4 * sum(sizes):
        raise ValueError(f"it has {len(data)} bytes, and its header promises {_HEADER + 4 * sum(sizes)}")
    starts = _HEADER + 4 * np.cumsum((0, *sizes))
    points = np.frombuffer(data, "<f4", sizes[0], int(starts[0])).reshape(-1, 3)
    uv = np.frombuffer(data, "<f4", sizes[2], int(starts[2])).reshape(-1, 2)
    triangles = np.frombuffer(data, "<i4", sizes[3], int(starts[3])).reshape(-1, 3)
    if faces and not 0 <= triangles.min() <= triangles.max() < vertices:
        raise ValueError("a triangle names a vertex that it does not have")
    return TexturedMesh(points, triangles, uv if texcoords == vertices else None)


def _read_other(path: Path) -> TexturedMesh:
    import trimesh

    mesh = trimesh.load_mesh(path)
    uv = getattr(mesh.visual, "uv", None)
    if uv is not None:  # MuJoCo counts from the image's upper edge
        uv = np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]).astype(np.float32)
    return TexturedMesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32), uv)

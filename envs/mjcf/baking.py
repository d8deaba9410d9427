"""Textures of simplified meshes.

A simplified mesh has lost the vertices at which its texture had seams, so its triangles get an image of their
own: each has a corner of it, which shows what the original surface shows at the nearest place. Shapes: F
triangles, P points.
"""

import numpy as np

from envs.mjcf.textured_mesh import TexturedMesh

SAMPLES = 150_000
"""Points of the original surface whose colours are looked up."""

LIFT = 0.02
"""Distance, as a share of the mesh's size, by which points are lifted off their surface before the nearest is
looked for: inside and outside of a bowl are millimetres apart."""

CREASE_COS = 0.5
"""Cosine of the largest angle between triangles that are shaded as one smooth surface."""


def baked(
    mesh: TexturedMesh, dense: TexturedMesh, image: np.ndarray, size: int
) -> tuple[TexturedMesh, np.ndarray]:
    """Returns a mesh with texture coordinates, and its image (size, size, 3) uint8.

    Args:
        mesh: The simplified mesh.
        dense: The original, with texture coordinates.
        image: The original's texture, (H, W, 3) uint8.
        size: Pixels along a side of the image; two triangles share a square of it.
    """
    from scipy.spatial import KDTree

    extent = float(np.ptp(dense.vertices, axis=0).max()) or 1.0
    points, normals, colors = _sampled(dense, image)
    lift = LIFT * extent
    tree = KDTree(points + lift * normals, balanced_tree=False, compact_nodes=False)
    count = len(mesh.faces)
    columns = max(1, int(np.ceil(np.sqrt((count + 1) // 2))))
    block = max(4, size // columns)
    side = columns * block
    pixels = np.zeros((side, side, 3), np.uint8)
    corners = mesh.vertices[mesh.faces].astype(np.float64)  # (F, 3, 3)
    facing = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    uv = np.empty((count, 3, 2))
    for half in (0, 1):
        faces = np.arange(half, count, 2)
        cell = faces // 2
        origin = np.stack([cell % columns, cell // columns], axis=1) * block  # x, y of the square
        places = _corner_places(block, half)
        uv[faces] = (origin[:, None] + places) / side
        cells, weights = _pixels_of(block, half, places)
        at = np.einsum("pk,fkd->fpd", weights, corners[faces])
        nearest = tree.query((at + lift * facing[faces, None]).reshape(-1, 3), workers=-1)[1]
        x, y = (origin[:, None] + cells).reshape(-1, 2).T
        pixels[y, x] = colors[nearest]
    flat = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    textured = TexturedMesh(
        mesh.vertices[mesh.faces].reshape(-1, 3),
        flat,
        uv.reshape(-1, 2).astype(np.float32),
        _smooth_normals(mesh, facing).reshape(-1, 3).astype(np.float32),
    )
    return textured, pixels


def _smooth_normals(mesh: TexturedMesh, facing: np.ndarray) -> np.ndarray:
    """Returns a normal for each corner of each triangle, (F, 3, 3): the mean round it, within a crease."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    at = mesh.faces.ravel()  # vertex of each corner, (3F,)
    by_vertex = np.argsort(at, kind="stable")
    counts = np.bincount(at, minlength=len(mesh.vertices))
    # Every pair of a corner and a triangle round its vertex, corner by corner.
    pairs = counts[at]
    corner = np.repeat(np.arange(len(at)), pairs)
    place = np.arange(pairs.sum()) - np.repeat(np.cumsum(pairs) - pairs, pairs)
    other = by_vertex[np.repeat((np.cumsum(counts) - counts)[at], pairs) + place] // 3
    near = np.einsum("pd,pd->p", facing[other], facing[corner // 3]) >= CREASE_COS
    corner, other = corner[near], other[near]
    out = np.zeros((len(at), 3))
    np.add.at(out, corner, area[other, None] * facing[other])
    out = out.reshape(corners.shape)
    alone = ~out.any(-1)
    out[alone] = np.repeat(facing[:, None], 3, axis=1)[alone]
    return _unit(out)


def _sampled(mesh: TexturedMesh, image: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns points (P, 3) of a surface, evenly spread, their normals (P, 3) and colours (P, 3) uint8."""
    assert mesh.uv is not None, "the original has a texture"
    rng = np.random.default_rng(0)
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    chosen = np.searchsorted(np.cumsum(area) / area.sum(), rng.random(SAMPLES))
    chosen = np.minimum(chosen, len(area) - 1)
    a, b = rng.random((2, SAMPLES))
    outside = a + b > 1.0
    a[outside], b[outside] = 1.0 - a[outside], 1.0 - b[outside]
    weights = np.stack([1.0 - a - b, a, b], axis=1)
    points = np.einsum("pk,pkd->pd", weights, corners[chosen])
    uv = np.einsum("pk,pkd->pd", weights, mesh.uv[mesh.faces][chosen]) % 1.0
    height, width = image.shape[:2]
    column = np.minimum((uv[:, 0] * width).astype(int), width - 1)
    row = np.minimum((uv[:, 1] * height).astype(int), height - 1)
    return points, _unit(cross)[chosen], image[row, column]


def _corner_places(block: int, half: int) -> np.ndarray:
    """Returns where the corners of a triangle are in its square, pixels, (3, 2): one lies lower left."""
    low, high = 0.5, block - 2.5
    places = np.array([(low, low), (high, low), (low, high)])
    return places if half == 0 else block - places


def _pixels_of(block: int, half: int, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the pixels (P, 2) of a triangle's half of a square, and their barycentric weights (P, 3)."""
    x, y = (values.ravel() for values in np.meshgrid(np.arange(block), np.arange(block)))
    own = (x + y < block - 1) if half == 0 else (x + y >= block - 1)
    cells = np.stack([x[own], y[own]], axis=1)
    first = places[1:] - places[0]
    along = np.linalg.solve(first.T, (cells + 0.5 - places[0]).T).T
    return cells, np.column_stack([1.0 - along.sum(axis=1), along])


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)

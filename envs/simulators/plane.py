"""A plane as two triangles, for renderers that draw it as a mesh."""

import numpy as np

_ENDLESS_M = 50.0


def plane_mesh(size: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Returns vertices (4, 3), triangles (2, 3), normals (4, 3), and metres from a corner (4, 2), of a plane.

    Args:
        size: Half its sides, as MuJoCo has them; 0 is without end.
    """
    half = np.where(size[:2] > 0.0, size[:2], _ENDLESS_M)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
    vertices = np.concatenate([corners, np.zeros((4, 1))], axis=1)
    return vertices, np.array([(0, 1, 2), (0, 2, 3)]), np.tile([0.0, 0.0, 1.0], (4, 1)), corners + half

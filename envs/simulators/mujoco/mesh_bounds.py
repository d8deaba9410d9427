"""Bounds of meshes in the world, for the ray tracer on a CPU.

mujoco_warp bounds a mesh by the upright box round a box that turns with it and is as wide to either side of
its origin. A turned link fills little of that, and every ray through it searches the mesh. These bounds are
never wider, and what they leave out no ray can hit: images are bit-identical. Shapes: G mesh geoms.
"""

from typing import Any

import mujoco
import numpy as np

_STRIDES = np.array([9, 3, 1])
_MIDDLE = 13
"""Place of (0, 0, 0) in :data:`_DIRECTIONS`; the opposite of a direction lies as far on its other side."""

_DIRECTIONS = np.stack(np.meshgrid(*3 * [(-1.0, 0.0, 1.0)], indexing="ij"), axis=-1).reshape(27, 3)

_PAD = 1e-5
"""Added to bounds, in m and as a share of a mesh's size, for rounding."""


class MeshBounds:
    """The bounds of a render context's meshes.

    A mesh's extent along any direction is at most the weighted sum of its extents along directions that add
    up to it. It is computed once along the 26 directions to the faces, edges and corners of a cube; every
    other one is a sum of three of those. A mesh that has not moved since the last image gets the exact bounds
    of its vertices, which are computed once.

    Args:
        model: The model that the context was made for.
        context: mujoco_warp's render context, of one world, on the CPU.
    """

    def __init__(self, model: mujoco.MjModel, context: Any) -> None:
        geoms = context.enabled_geom_ids.numpy()
        is_mesh = (model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_MESH) & (model.geom_dataid[geoms] >= 0)
        self._rows = np.flatnonzero(is_mesh)
        self._geoms = geoms[self._rows]
        self._lower, self._upper = context.lower.numpy(), context.upper.numpy()
        self._vertices = [_vertices(model, mesh) for mesh in model.geom_dataid[self._geoms].tolist()]
        extents = [(vertices @ _DIRECTIONS.T).max(axis=0) for vertices in self._vertices]
        self._extents = np.array(extents).reshape(-1, 27)
        self._pad = _PAD * (1.0 + np.abs(self._extents).max(axis=1, initial=0.0))[:, None]
        self._poses = np.full((len(self._geoms), 12), np.nan)
        self._exact = np.zeros(len(self._geoms), bool)
        self._own_lower, self._own_upper = np.empty((2, len(self._geoms), 3))

    def write(self, data: mujoco.MjData) -> None:
        """Writes the bounds at the poses of ``data`` into the context."""
        poses = np.concatenate([data.geom_xpos[self._geoms], data.geom_xmat[self._geoms]], axis=1)
        moved = (poses != self._poses).any(axis=1)
        self._poses = poses
        self._write_exactly(np.flatnonzero(~moved & ~self._exact))
        self._exact = ~moved
        self._write_summed(np.flatnonzero(moved))
        self._lower[self._rows], self._upper[self._rows] = self._own_lower, self._own_upper

    def _write_exactly(self, places: np.ndarray) -> None:
        """Bounds each of the meshes by its vertices."""
        for place in places.tolist():
            pos, axes = self._poses[place, :3], self._poses[place, 3:].reshape(3, 3)
            along = self._vertices[place] @ axes.T
            self._own_lower[place] = pos + along.min(axis=0) - self._pad[place]
            self._own_upper[place] = pos + along.max(axis=0) + self._pad[place]

    def _write_summed(self, places: np.ndarray) -> None:
        """Bounds the meshes by sums of their extents."""
        extents, each = self._extents[places], np.arange(len(places))[:, None, None]
        pos, axes = self._poses[places, :3], self._poses[places, 3:].reshape(-1, 3, 3)
        lengths = np.abs(axes)
        order = np.argsort(-lengths, axis=-1)
        lengths = np.take_along_axis(lengths, order, axis=-1)
        signs = np.where(np.take_along_axis(axes, order, axis=-1) < 0.0, -1, 1)
        along = np.cumsum(signs * _STRIDES[order], axis=-1)  # to a face, an edge and a corner, (G, 3, 3)
        weights = lengths.copy()
        weights[..., :2] -= lengths[..., 1:]
        above = (weights * extents[each, _MIDDLE + along]).sum(-1)
        below = (weights * extents[each, _MIDDLE - along]).sum(-1)
        self._own_lower[places] = pos - below - self._pad[places]
        self._own_upper[places] = pos + above + self._pad[places]


def _vertices(model: mujoco.MjModel, mesh: int) -> np.ndarray:
    """Returns a mesh's vertices, (V, 3) float32, the model's own."""
    start = model.mesh_vertadr[mesh]
    return model.mesh_vert[start : start + model.mesh_vertnum[mesh]]

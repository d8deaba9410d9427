"""Boxes round what moves in a scene, and which pixels they may change.

A pixel shows what its ray meets first, in the light that reaches that point. So a box can change it only
where the ray, or the line from that point to the light, meets the box. Both are tested in a plane: in the
camera's, and in one across the light. The tests err to one side: a pixel that they leave out is certainly the
same with and without the boxes.

Shapes: B boxes, P pixels of all cameras.
"""

from dataclasses import dataclass
from typing import Self

import mujoco
import numpy as np

_PAD_M = 1e-3
"""Added to boxes, in m: far more than the rounding of the tracer and the offset of its shadow rays."""

_PAD_TANGENT = 1e-4
"""Added in the camera's plane at a distance of one; pixels lie fifty times as far apart."""

_CELLS = 512
"""Cells along each side of the plane across the light."""

_SIGNS = np.stack(np.meshgrid(*3 * [(-1.0, 1.0)], indexing="ij"), axis=-1).reshape(8, 3)


def can_move(model: mujoco.MjModel) -> np.ndarray:
    """Returns which bodies have a joint above them or are put in place, (nbody,) bool."""
    movable = (model.body_jntnum > 0) | (model.body_mocapid >= 0)
    for body in range(1, model.nbody):  # parents come first
        movable[body] |= movable[model.body_parentid[body]]
    return movable


class Boxes:
    """A box round each of some geoms.

    Args:
        model: The model.
        geoms: Ids of the geoms.
    """

    def __init__(self, model: mujoco.MjModel, geoms: np.ndarray) -> None:
        self._geoms = geoms
        middle, half = model.geom_aabb[geoms].reshape(-1, 2, 1, 3).swapaxes(0, 1)
        self._corners = middle + (half + _PAD_M) * _SIGNS  # in the geom's frame

    def corners(self, data: mujoco.MjData) -> np.ndarray:
        """Returns their corners in the world, (B, 8, 3)."""
        axes = data.geom_xmat[self._geoms].reshape(-1, 3, 3)
        return self._corners @ axes.transpose(0, 2, 1) + data.geom_xpos[self._geoms][:, None]


@dataclass(frozen=True, slots=True)
class CameraPlane:
    """The pixels of a fixed camera.

    Attributes:
        pos: The camera's position, (3,).
        axes: Its axes as columns, (3, 3); it looks along the third, backwards.
        columns: Tangents of the pixels' rays to the right, ascending.
        rows: Downwards, ascending.
    """

    pos: np.ndarray
    axes: np.ndarray
    columns: np.ndarray
    rows: np.ndarray

    @classmethod
    def of(cls, pos: np.ndarray, axes: np.ndarray, rays: np.ndarray) -> Self | None:
        """Returns the plane of a camera with rays (H, W, 3) in its frame; None if they are no grid."""
        tangents = rays[..., :2].astype(np.float64) / -rays[..., 2:].astype(np.float64)
        columns, rows = tangents[0, :, 0], -tangents[:, 0, 1]
        is_grid = np.abs(tangents[..., 0] - columns).max() < _PAD_TANGENT / 2
        is_grid &= np.abs(tangents[..., 1] + rows[:, None]).max() < _PAD_TANGENT / 2
        is_grid &= (np.diff(columns) > 0).all() and (np.diff(rows) > 0).all()
        return cls(pos, axes, columns, rows) if is_grid else None

    def touched(self, corners: np.ndarray) -> np.ndarray:
        """Returns which pixels' rays may meet boxes with corners (B, 8, 3), (H, W) bool."""
        local = (corners - self.pos) @ self.axes
        ahead = -local[..., 2]
        visible = (ahead > 0.0).any(axis=1)
        local, ahead = local[visible], ahead[visible]
        mask = np.zeros((len(self.rows), len(self.columns)), bool)
        if (ahead < _PAD_M).any():  # a box round the camera
            mask[:] = True
            return mask
        right, down = local[..., 0] / ahead, -local[..., 1] / ahead
        _fill(mask, *(_spans(self.rows, down)), *(_spans(self.columns, right)))
        return mask


def _spans(places: np.ndarray, values: np.ndarray) -> tuple[list[int], list[int]]:
    """Returns the first of the ascending places among the values of each row, and the one after the last."""
    first = np.searchsorted(places, values.min(axis=1) - _PAD_TANGENT)
    return first.tolist(), np.searchsorted(places, values.max(axis=1) + _PAD_TANGENT, side="right").tolist()


def _fill(mask: np.ndarray, tops: list[int], bottoms: list[int], lefts: list[int], rights: list[int]) -> None:
    for top, bottom, left, right in zip(tops, bottoms, lefts, rights, strict=True):
        mask[top:bottom, left:right] = True


@dataclass(frozen=True, slots=True)
class LightPlane:
    """A plane across a distant light, and where it sees the points that pixels show.

    Attributes:
        across: Two directions across the light as columns, (3, 2).
        origin: Lowest place in the plane, (2,).
        scale: Cells in a metre, (2,).
        cell: Cell of each pixel, (P,); one more than there are where it shows nothing.
    """

    across: np.ndarray
    origin: np.ndarray
    scale: np.ndarray
    cell: np.ndarray

    @classmethod
    def of(cls, direction: np.ndarray, points: np.ndarray, shown: np.ndarray) -> Self:
        """Returns the plane across a direction for points (P, 3), of which those matter that are shown."""
        _, _, axes = np.linalg.svd(direction[None])
        across = axes[1:].T
        places = points @ across
        cell = np.full(len(points), _CELLS**2, np.int32)
        if not shown.any():
            return cls(across, np.zeros(2), np.ones(2), cell)
        origin = places[shown].min(axis=0)
        scale = (_CELLS - 1) / np.maximum(places[shown].max(axis=0) - origin, 1e-6)
        cell[shown] = ((places[shown] - origin) * scale).astype(int).clip(0, _CELLS - 1) @ (_CELLS, 1)
        return cls(across, origin, scale, cell)

    def touched(self, corners: np.ndarray) -> np.ndarray:
        """Returns which pixels may lie in the shadow of boxes with corners (B, 8, 3), (P,) bool."""
        places = (corners @ self.across - self.origin) * self.scale
        low = np.floor(places.min(axis=1)).clip(0, _CELLS).astype(int)
        high = (np.floor(places.max(axis=1)) + 1).clip(0, _CELLS).astype(int)
        flat = np.zeros(_CELLS**2 + 1, bool)
        mask = flat[:-1].reshape(_CELLS, _CELLS)
        _fill(mask, *(one.tolist() for one in (low[:, 0], high[:, 0], low[:, 1], high[:, 1])))
        return flat[self.cell]

"""Collision geometry as points, and how low one thing can be put down on others.

Heights are kept in square cells of a level grid: enough for hands and objects that come from above. Shapes: P
points.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from envs.kinematics.object_parts import ObjectParts
from envs.rotations import rotate
from envs.state import EntityState

SPACING_M = 0.006
"""Distance of neighbouring points on a box."""

CELL_M = 0.005
"""Side of a cell."""


@lru_cache(maxsize=256)
def _surface(parts: ObjectParts) -> tuple[tuple[int, np.ndarray], ...]:
    """Returns points on the boxes of each part that has some, in the part's frame."""
    found: dict[int, list[np.ndarray]] = {}
    for box in parts.boxes:
        found.setdefault(box.part, []).append(box.pos + rotate(box.rot, box_points(box.half)))
    return tuple((part, thinned(np.concatenate(points))) for part, points in found.items())


def thinned(points: np.ndarray, spacing: float = SPACING_M) -> np.ndarray:
    """Returns one of the points (P, 3) of each cube of that size: boxes of one thing overlap."""
    _, first = np.unique(np.round(points / spacing).astype(int), axis=0, return_index=True)
    return points[np.sort(first)]


def box_points(half: np.ndarray, spacing: float = SPACING_M) -> np.ndarray:
    """Returns points (P, 3) on the surface of a box of half sizes (3,), m."""
    counts = np.maximum(np.ceil(2 * half / spacing).astype(int) + 1, 2)
    axes = [np.linspace(-size, size, count) for size, count in zip(half, counts, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    shell = np.ones(grid.shape[:3], bool)
    shell[1:-1, 1:-1, 1:-1] = False
    return grid[shell]


def cloud(parts: ObjectParts, entity: EntityState) -> np.ndarray:
    """Returns points (P, 3) of what collides, in the world, of a state of one row."""
    placed = []
    for part, points in _surface(parts):
        pos, rot = parts.part_pose(entity, part)
        placed.append(pos[0].numpy() + rotate(rot[0].numpy(), points))
    return np.concatenate(placed) if placed else np.zeros((0, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Underside:
    """The lowest points of something, cell by cell, from a reference point.

    Attributes:
        cells: Columns and rows from the reference point, (P, 2) int.
        z: Height of the lowest point of each over the reference point, m, (P,).
    """

    cells: np.ndarray
    z: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray) -> "Underside":
        """Returns the underside of points (P, 3), which are given from the reference point."""
        cells = np.round(points[:, :2] / CELL_M).astype(int)
        first = cells.min(0)
        lowest = np.full(cells.max(0) - first + 1, np.inf)
        np.minimum.at(lowest, tuple((cells - first).T), points[:, 2])
        found = np.argwhere(np.isfinite(lowest))
        return cls(found + first, lowest[tuple(found.T)])

    def joined(self, other: "Underside") -> "Underside":
        """Returns the underside of both."""
        return Underside(np.concatenate([self.cells, other.cells]), np.concatenate([self.z, other.z]))


class Heights:
    """The highest points of obstacles, cell by cell.

    Args:
        clouds: Points of the obstacles, (P, 3) each.
        ground: Height of what carries them, m.
        low: Least x and y of the grid, m.
        high: Largest x and y.
    """

    def __init__(
        self,
        clouds: Iterable[np.ndarray],
        ground: float,
        low: tuple[float, float] = (-1.0, -1.0),
        high: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        self._low = np.array(low)
        self._size = np.round((np.array(high) - self._low) / CELL_M).astype(int) + 1
        self._top = np.full(tuple(self._size), ground)
        for points in clouds:
            cells, inside = self._cells(points[:, :2])
            np.maximum.at(self._top, tuple(cells[inside].T), points[inside, 2])

    def _cells(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        cells = np.round((places - self._low) / CELL_M).astype(int)
        return cells, np.all((cells >= 0) & (cells < self._size), axis=-1)

    def rest(self, places: np.ndarray, underside: Underside) -> np.ndarray:
        """Returns the heights (P,) of the reference point at which something touches, at places (P, 2)."""
        middle, _ = self._cells(places)
        own, last = underside.cells, self._size - 1
        if (middle.min(0) + own.min(0) < 0).any() or (middle.max(0) + own.max(0) > last).any():
            cells = np.clip(middle[:, None] + own, 0, last)
            return (self._top[cells[..., 0], cells[..., 1]] - underside.z).max(axis=1)
        steps = np.array([self._size[1], 1])  # all inside: one index a cell, in half the time
        return (self._top.ravel()[(middle @ steps)[:, None] + own @ steps] - underside.z).max(axis=1)

    def along(self, start: np.ndarray, end: np.ndarray, underside: Underside) -> float:
        """Returns the least height at which something passes from one place (2,) to another."""
        count = max(2, int(np.linalg.norm(end - start) / 0.02) + 1)
        return float(self.rest(np.linspace(start, end, count), underside).max())

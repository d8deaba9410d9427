"""Rigid poses in batches: what a hand path relative to an object is computed with.

Shapes: ``...`` is any number of leading axes, which broadcast. Quaternions are wxyz.
"""

from typing import NamedTuple

import numpy as np

from envs.rotations import conjugate, multiply, rotate


class Pose(NamedTuple):
    """Frames in the world, or in one another: ``T_world_hand = T_world_object @ T_object_hand``.

    Attributes:
        pos: Origins, m, (..., 3).
        rot: Orientations, unit quaternions wxyz, (..., 4).
    """

    pos: np.ndarray
    rot: np.ndarray

    def __matmul__(self, other: "Pose") -> "Pose":  # type: ignore[override]
        """Returns the frames ``other``, given in these frames, where these are given."""
        return Pose(self.pos + rotate(self.rot, other.pos), multiply(self.rot, other.rot))

    def inverse(self) -> "Pose":
        """Returns the frames' parents, in the frames."""
        back = conjugate(self.rot)
        return Pose(-rotate(back, self.pos), back)

    def rows(self, index: int | slice | np.ndarray) -> "Pose":
        """Returns some of the frames, by the first axis."""
        return Pose(self.pos[index], self.rot[index])


def distance_m(one: Pose, other: Pose) -> np.ndarray:
    """Returns how far apart the origins are, (...,)."""
    return np.linalg.norm(one.pos - other.pos, axis=-1)


def angle_rad(one: Pose, other: Pose) -> np.ndarray:
    """Returns the angle between the orientations, in [0, π], (...,)."""
    turn = multiply(conjugate(one.rot), other.rot)
    return 2.0 * np.arctan2(np.linalg.norm(turn[..., 1:], axis=-1), np.abs(turn[..., 0]))


def partly(rot: np.ndarray, share: np.ndarray, *, long_way: bool = False) -> np.ndarray:
    """Returns the rotation ``rot`` (4,) by a share (T,) of its angle, about the same axis, (T, 4).

    Args:
        rot: A rotation by an angle in [0, π].
        share: Shares of the angle.
        long_way: Turn the other way round, by 2π less the angle.
    """
    if (rot[0] < 0) != long_way:
        rot = -rot
    sine = np.linalg.norm(rot[1:])
    if sine < 1e-12:
        return np.tile([1.0, 0.0, 0.0, 0.0], (len(share), 1))
    half = np.arctan2(sine, rot[0]) * share
    return np.concatenate([np.cos(half)[:, None], np.sin(half)[:, None] * (rot[1:] / sine)], axis=1)

"""Rotations of batched quaternions (w, x, y, z), for numpy arrays and torch tensors alike.

Every function works on the last axis and broadcasts the others.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

Array = Any  # numpy.ndarray or torch.Tensor


def _stack(parts: list[Array]) -> Array:
    if isinstance(parts[0], np.ndarray | np.generic):  # a single quaternion has scalar parts
        return np.stack(parts, axis=-1)
    import torch

    return torch.stack(parts, dim=-1)


def _cross(a: Array, b: Array) -> Array:
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return _stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def conjugate(q: Array) -> Array:
    """Returns the inverse of unit quaternions ``q`` (..., 4)."""
    return _stack([q[..., 0], -q[..., 1], -q[..., 2], -q[..., 3]])


def multiply(p: Array, q: Array) -> Array:
    """Returns the Hamilton product ``p q`` (..., 4): first ``q``, then ``p``."""
    pw, px, py, pz = p[..., 0], p[..., 1], p[..., 2], p[..., 3]
    qw, qx, qy, qz = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    return _stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ]
    )


def rotate(q: Array, v: Array) -> Array:
    """Returns vectors ``v`` (..., 3) turned by unit quaternions ``q`` (..., 4)."""
    imaginary = q[..., 1:]
    twice = 2.0 * _cross(imaginary, v)
    return v + q[..., :1] * twice + _cross(imaginary, twice)


def from_yaw(yaw: Array) -> Array:
    """Returns the quaternion (..., 4) of a turn by ``yaw`` radians about z; of a plain number, as numpy."""
    if isinstance(yaw, np.ndarray | np.generic | float | int):
        half = 0.5 * np.asarray(yaw, dtype=np.float64)
        zero = np.zeros_like(half)
        return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)
    half = 0.5 * yaw
    zero = half.new_zeros(half.shape)
    return _stack([half.cos(), zero, zero, half.sin()])


def from_euler(angles: np.ndarray) -> np.ndarray:
    """Returns quaternions (..., 4) of turns by ``angles`` (..., 3), rad: Rz(yaw) Ry(pitch) Rx(roll)."""
    cz, cy, cx = np.moveaxis(np.cos(0.5 * np.asarray(angles, np.float64)), -1, 0)
    sz, sy, sx = np.moveaxis(np.sin(0.5 * np.asarray(angles, np.float64)), -1, 0)
    return np.stack(
        [
            cz * cy * cx + sz * sy * sx,
            cz * cy * sx - sz * sy * cx,
            cz * sy * cx + sz * cy * sx,
            sz * cy * cx - cz * sy * sx,
        ],
        axis=-1,
    )


def to_euler(q: np.ndarray) -> np.ndarray:
    """Returns yaw, pitch and roll (..., 3), rad, of quaternions (..., 4); inverts :func:`from_euler`."""
    w, x, y, z = np.moveaxis(np.asarray(q, np.float64), -1, 0)
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return np.stack([yaw, pitch, roll], axis=-1)


def wrapped(angle: Array) -> Array:
    """Returns the angles (...,) of the same turns in [-π, π); a float is one, too."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def yaw_of(q: Array) -> Array:
    """Returns the heading (...,) in radians: the angle of the turned x axis about z."""
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    sine, cosine = 2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)
    if isinstance(q, np.ndarray | np.generic):
        return np.arctan2(sine, cosine)
    import torch

    return torch.atan2(sine, cosine)


def uprightness(q: Array) -> Array:
    """Returns the cosine (...,) between the turned z axis and the vertical: 1 where it points up."""
    x, y = q[..., 1], q[..., 2]
    return 1.0 - 2.0 * (x * x + y * y)


def to_matrix(q: Array) -> Array:
    """Returns rotation matrices (..., 3, 3) of unit quaternions ``q`` (..., 4)."""
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    wx, wy, wz, xx, xy, xz, yy, yz, zz = w * x, w * y, w * z, x * x, x * y, x * z, y * y, y * z, z * z
    halves = [
        *(0.5 - (yy + zz), xy - wz, xz + wy),
        *(xy + wz, 0.5 - (xx + zz), yz - wx),
        *(xz - wy, yz + wx, 0.5 - (xx + yy)),
    ]
    return (2 * _stack(halves)).reshape(*q.shape[:-1], 3, 3)


def from_matrix(matrix: Array) -> Array:
    """Returns unit quaternions (..., 4) of rotation matrices (..., 3, 3); their largest part is positive.

    Of the four ways to write one, the best conditioned (Shepperd, "Quaternion from rotation matrix",
    Journal of Guidance and Control 1, 1978).
    """
    (a, b, c), (d, e, f), (g, h, i) = ([matrix[..., row, col] for col in range(3)] for row in range(3))
    ways = [
        _stack([1 + a + e + i, h - f, c - g, d - b]),
        _stack([h - f, 1 + a - e - i, b + d, c + g]),
        _stack([c - g, b + d, 1 - a + e - i, f + h]),
        _stack([d - b, c + g, f + h, 1 - a - e + i]),
    ]
    sizes = _stack([ways[index][..., index] for index in range(4)])
    best = sizes.argmax(-1)[..., None, None]
    if isinstance(matrix, np.ndarray):
        q = np.take_along_axis(np.stack(ways, axis=-2), best, axis=-2)[..., 0, :]
        return q / np.linalg.norm(q, axis=-1, keepdims=True)
    import torch

    q = torch.take_along_dim(torch.stack(ways, dim=-2), best, dim=-2)[..., 0, :]
    return q / torch.linalg.vector_norm(q, dim=-1, keepdim=True)


def look_at_matrix(pos: np.ndarray, target: np.ndarray, up: Sequence[float] = (0.0, 0.0, 1.0)) -> np.ndarray:
    """Returns the (3, 3) orientation of a camera at ``pos`` that looks at ``target``.

    Columns are the camera's axes: x right, y up, and z backwards, as in MuJoCo and OpenGL. ``up``
    points up in the image; a camera that looks along it has x up.
    """
    backward = np.asarray(pos, np.float64) - np.asarray(target, np.float64)
    backward /= np.linalg.norm(backward)
    if abs(backward @ np.asarray(up)) > 0.9999 * np.linalg.norm(up):
        up = (1.0, 0.0, 0.0)
    right = np.cross(up, backward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(backward, right), backward], axis=-1)

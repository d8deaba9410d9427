"""Velocities of bodies, in MuJoCo's terms and in PhysX's.

MuJoCo's velocity is that of the body's origin, in the world, and its rate of turning is in the body's frame.
PhysX's is that of the centre of mass, and its rate of turning is in the world.
"""

from collections.abc import Sequence

import numpy as np


def to_physx(rot: np.ndarray, lin: np.ndarray, ang: np.ndarray, centre: np.ndarray | None) -> tuple:
    """Returns PhysX's linear and angular velocity, (3,) each.

    Args:
        rot: Orientation of the body, wxyz.
        lin: MuJoCo's linear velocity, (3,).
        ang: MuJoCo's angular velocity, (3,).
        centre: Centre of mass in the body's frame, or None at its origin.
    """
    turning = _turned(rot.tolist(), ang.tolist())
    speed = lin.astype(np.float64)
    if centre is not None:
        speed = speed + np.cross(turning, _turned(rot.tolist(), centre.tolist()))
    return speed.astype(np.float32), np.array(turning, np.float32)


def from_physx(rot: np.ndarray, lin: np.ndarray, ang: np.ndarray, centre: np.ndarray | None) -> tuple:
    """Returns MuJoCo's linear and angular velocity, (3,) each; the inverse of :func:`to_physx`."""
    turn = w, x, y, z = rot.tolist()
    if centre is not None:
        lin = lin - np.cross(ang.astype(np.float64), _turned(turn, centre.tolist()))
    return lin, _turned((w, -x, -y, -z), ang.tolist())


def _turned(rot: Sequence[float], vector: Sequence[float]) -> tuple[float, float, float]:
    """Returns a vector (3,) turned by a quaternion (4,): three numbers are not worth an array."""
    (w, x, y, z), (a, b, c) = rot, vector
    p, q, r = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return (
        a + w * p + y * r - z * q,
        b + w * q + z * p - x * r,
        c + w * r + x * q - y * p,
    )

"""The Franka hand as boxes, for room to grasp and to let go.

The frame is that of the waypoints: its origin between the fingertips (``grip_site``), x along the depth of
the hand, y along which the fingers close, z upwards while the hand points down.
"""

from functools import lru_cache

import numpy as np

from envs.tasks.skills.clouds import Underside, box_points

TIP_BELOW_M = 0.012
"""How far the fingertips reach below the grip site."""

FINGER_HALF_M = (0.011, 0.011)
"""Half depth and half thickness of a finger."""

PALM_M = 0.043
"""Height of the palm over the grip site."""

PALM_HALF_M = (0.034, 0.108)
"""Half depth and half width of the hand above the fingers."""

FINGER_MOST_M = 0.04
"""Largest way of each finger."""


def hand_underside(
    yaw: float, opening_m: float = FINGER_MOST_M, opens_from_m: float | None = None
) -> Underside:
    """Returns the underside of a hand that points down.

    Args:
        yaw: Turn of the hand about z, rad.
        opening_m: Distance of each finger from the middle.
        opens_from_m: Distance from which the fingers open; the underside then covers their way, too. Without
            it they stay.
    """
    points = _points(opening_m, opening_m if opens_from_m is None else opens_from_m)
    cosine, sine = np.cos(yaw), np.sin(yaw)
    turned = points[:, :2] @ np.array([[cosine, sine], [-sine, cosine]])
    return Underside.of(np.column_stack([turned, points[:, 2]]))


@lru_cache(maxsize=16)
def _points(opening_m: float, opens_from_m: float) -> np.ndarray:
    """Returns the undersides of palm and fingers, (P, 3)."""
    palm = _slab(0.0, PALM_HALF_M, PALM_M)
    middle = (opens_from_m + opening_m) / 2 + FINGER_HALF_M[1]
    half = (FINGER_HALF_M[0], (opening_m - opens_from_m) / 2 + FINGER_HALF_M[1])
    fingers = [_slab(side * middle, half, -TIP_BELOW_M) for side in (-1.0, 1.0)]
    return np.concatenate([palm, *fingers])


def _slab(y: float, half: tuple[float, float], z: float) -> np.ndarray:
    points = box_points(np.array([*half, 1e-6]), 0.004)
    return points + np.array([0.0, y, z])

"""Grasps from above, found on collision geometry: across an object, or over its rim."""

from dataclasses import dataclass

import numpy as np

from envs.tasks.skills.hands import FINGER_HALF_M, FINGER_MOST_M, PALM_HALF_M, PALM_M, TIP_BELOW_M

YAWS = np.linspace(-np.pi / 2, np.pi / 2, 12, endpoint=False)
"""Turns of the hand that are tried; the hand looks the same half a turn on."""

DEPTHS_M = (0.035, 0.022, 0.013)
"""How far below the upper edge the grip site comes."""

OPENINGS_M = (0.04, 0.022)
"""Distances of each finger from the middle that are tried, the widest first."""

MARGIN_M = 0.004
"""Room that fingers need on each side."""

CENTRES = 48
"""Places on an object that are tried."""

PAD_HALF_M = 0.009
"""Half the height and half the depth of a finger's pad."""


@dataclass(frozen=True, slots=True, eq=False)
class Grasp:
    """A pose of the hand that points down, and how far its fingers open first.

    Attributes:
        pos: The grip site, m, (3,).
        yaw: Turn about z, rad.
        opening_m: Distance of each finger from the middle.
        score: The larger the better.
    """

    pos: np.ndarray
    yaw: float
    opening_m: float
    score: float


def top_grasps(
    points: np.ndarray, obstacles: np.ndarray, lowest_z: float, rng: np.random.Generator
) -> list[Grasp]:
    """Returns grasps of an object from above, the best first.

    Args:
        points: The object, (P, 3), m.
        obstacles: Everything else, (Q, 3).
        lowest_z: Least height of the grip site: fingertips do not scrape along what carries the object.
        rng: Varies which places are tried, and the order of what is equally good.
    """
    middle = (points.min(0) + points.max(0)) / 2
    reach = np.linalg.norm(points[:, :2] - middle[:2], axis=1).max() + 0.15
    near = np.linalg.norm(obstacles[:, :2] - middle[:2], axis=1) < reach
    solid = np.concatenate([points, obstacles[near]])
    own = np.arange(len(solid)) < len(points)
    centres = _centres(points, rng)
    grasps: list[Grasp] = []
    for yaw in YAWS + rng.uniform(0.0, YAWS[1] - YAWS[0]):
        grasps += _at_yaw(solid, own, centres, float(yaw), middle, lowest_z, rng)
    return sorted(grasps, key=lambda grasp: -grasp.score)


def _centres(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Returns places (C, 3) on the upper edge: the highest point of level cells of 1 cm."""
    cells = np.round(points[:, :2] / 0.01).astype(int)
    order = np.lexsort((-points[:, 2], cells[:, 1], cells[:, 0]))
    _, first = np.unique(cells[order], axis=0, return_index=True)
    tops = points[order[first]]
    middle = np.array([*points[:, :2].mean(0), points[:, 2].max()])
    if len(tops) > CENTRES:
        tops = tops[rng.choice(len(tops), CENTRES, replace=False)]
    return np.concatenate([middle[None], tops])


def _at_yaw(
    solid: np.ndarray,
    own: np.ndarray,
    centres: np.ndarray,
    yaw: float,
    middle: np.ndarray,
    lowest_z: float,
    rng: np.random.Generator,
) -> list[Grasp]:
    cosine, sine = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cosine, -sine], [sine, cosine]])  # columns: along depth, along closing
    flat, at = solid[:, :2] @ turn, centres[:, :2] @ turn
    x = np.abs(flat[:, 0] - at[:, :1])  # (C, P)
    y = flat[:, 1] - at[:, 1:]
    in_depth = (x < PAD_HALF_M) & (np.abs(y) < FINGER_MOST_M)
    found = []
    for depth in DEPTHS_M:
        z = solid[:, 2] - np.maximum(centres[:, 2:] - depth, lowest_z)
        held = in_depth & own & (np.abs(z) < PAD_HALF_M)
        some = held.any(1)
        low = np.where(some, np.where(held, y, np.inf).min(1), 0.0)
        high = np.where(some, np.where(held, y, -np.inf).max(1), 0.0)
        shift, width = (low + high) / 2, high - low
        good = some & (width < 2 * FINGER_MOST_M - 2 * MARGIN_M) & (np.abs(shift) < 0.02)
        for index in np.flatnonzero(good):
            grasp = _checked(
                x[index], y[index] - shift[index], z[index], float(width[index]), held[index], flat
            )
            if grasp is None:
                continue
            opening, score = grasp
            place = at[index] + np.array([0.0, shift[index]])
            pos = np.array([*(turn @ place), max(centres[index, 2] - depth, lowest_z)])
            away = float(np.linalg.norm(pos[:2] - middle[:2]))
            total = score - away / 0.05 - abs(yaw) / np.pi * 0.5 + rng.uniform(0.0, 0.15)
            found.append(Grasp(pos, yaw, opening, total + 10.0 * depth))
    return found


def _checked(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    width: float,
    held: np.ndarray,
    flat: np.ndarray,
) -> tuple[float, float] | None:
    """Returns how far the fingers open and a score, or None where the hand has no room."""
    palm = (x < PALM_HALF_M[0]) & (np.abs(y) < PALM_HALF_M[1]) & (z > PALM_M)
    if palm.any():
        return None
    finger = (x < FINGER_HALF_M[0] + 0.002) & (z > -TIP_BELOW_M - 0.002)
    for opening in OPENINGS_M:
        if width / 2 + MARGIN_M > opening:
            continue
        room = (np.abs(y) > opening - 0.001) & (np.abs(y) < opening + 2 * FINGER_HALF_M[1] + 0.002)
        if not (finger & room).any():
            return opening, min(float(np.ptp(flat[held, 0])), 0.018) / 0.018 * 0.5
    return None

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

FREE_BELOW_M = 0.002
"""Room that fingertips need below."""

MOST_SHIFT_M = 0.02
"""Largest distance along the way of the fingers between a place and the middle of what is held there."""

PAD_HALF_M = 0.009
"""Half the height and half the depth of a finger's pad."""

LUCK = 0.15
"""Most that chance adds to the score of a grasp."""

SIDE = np.array([1.0, 0.0])
"""Without chance: how much worse a grasp scores for each metre along x and y, so that of two sides of a bowl
it is always the same one."""

SKEW_COST = 35.0
"""Without chance: how much worse a grasp scores for each metre by which what is held is wider than in the
middle of the fingers. So is what lies askew, such as the rim of a bowl: it turns when they close."""


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
    points: np.ndarray, obstacles: np.ndarray, lowest_z: float, rng: np.random.Generator | None
) -> list[Grasp]:
    """Returns grasps of an object from above, the best first.

    Args:
        points: The object, (P, 3), m.
        obstacles: Everything else, (Q, 3).
        lowest_z: Least height of the grip site: fingertips do not scrape along what carries the object.
        rng: Varies which places are tried, and the order of what is nearly as good. Without it the grasps of
            an object are always the same.
    """
    middle = (points.min(0) + points.max(0)) / 2
    reach = np.linalg.norm(points[:, :2] - middle[:2], axis=1).max() + 0.15
    near = np.linalg.norm(obstacles[:, :2] - middle[:2], axis=1) < reach
    centres = _centres(points, middle, rng)
    deepest = max(centres[:, 2].min() - max(DEPTHS_M), lowest_z)
    near &= obstacles[:, 2] > deepest - TIP_BELOW_M - FREE_BELOW_M
    solid = np.concatenate([points, obstacles[near]])
    grasps: list[Grasp] = []
    for yaw in YAWS + (0.0 if rng is None else rng.uniform(0.0, YAWS[1] - YAWS[0])):
        grasps += _at_yaw(solid, len(points), centres, float(yaw), middle, lowest_z, rng)
    return sorted(grasps, key=lambda grasp: -grasp.score)


def _centres(points: np.ndarray, middle: np.ndarray, rng: np.random.Generator | None) -> np.ndarray:
    """Returns places (C, 3) on the upper edge: the highest point of level cells of 1 cm."""
    cells = np.round((points[:, :2] - middle[:2]) / 0.01).astype(int)
    order = np.lexsort((-points[:, 2], cells[:, 1], cells[:, 0]))
    _, first = np.unique(cells[order], axis=0, return_index=True)
    tops = points[order[first]]
    highest = np.array([*points[:, :2].mean(0), points[:, 2].max()])
    if len(tops) > CENTRES:
        evenly = np.linspace(0, len(tops) - 1, CENTRES).astype(int)
        tops = tops[evenly if rng is None else rng.choice(len(tops), CENTRES, replace=False)]
    return np.concatenate([highest[None], tops])


def _at_yaw(
    solid: np.ndarray,
    own: int,
    centres: np.ndarray,
    yaw: float,
    middle: np.ndarray,
    lowest_z: float,
    rng: np.random.Generator | None,
) -> list[Grasp]:
    """Returns the grasps of a turn; the first ``own`` points of ``solid`` are the object's."""
    cosine, sine = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cosine, -sine], [sine, cosine]])  # columns: along depth, along closing
    flat, at = solid[:, :2] @ turn, centres[:, :2] @ turn
    under = _Under.of(flat, at, solid[:, 2])
    found = []
    for depth in DEPTHS_M:
        height = np.maximum(centres[:, 2] - depth, lowest_z)
        z = under.z - height[under.centre]
        held = (under.point < own) & (under.x < PAD_HALF_M) & (abs(under.y) < FINGER_MOST_M)
        held &= abs(z) < PAD_HALF_M
        some = under.any(held)
        low, high = (np.where(some, end, 0.0) for end in under.ends(under.y, held))
        shift, width = (low + high) / 2, high - low
        # Only grasps without chance use it.
        skew = width - under.width(held & (under.x < PAD_HALF_M / 3)) if rng is None else None
        good = some & (width < 2 * FINGER_MOST_M - 2 * MARGIN_M) & (abs(shift) < MOST_SHIFT_M)
        opening = _openings(under, abs(under.y - shift[under.centre]), z, width)
        least, most = under.ends(flat[under.point, 0], held)
        index = np.flatnonzero(good & (opening > 0.0))
        luck = np.zeros(len(index)) if rng is None else rng.uniform(0.0, LUCK, len(index))
        for row, drawn in zip(index.tolist(), luck.tolist(), strict=True):
            pos = np.array([*(turn @ (at[row] + np.array([0.0, shift[row]]))), height[row]])
            away = float(np.linalg.norm(pos[:2] - middle[:2]))
            score = min(float(most[row] - least[row]), 0.018) / 0.018 * 0.5
            total = score - away / 0.05 - abs(yaw) / np.pi * 0.5 + drawn
            if skew is not None:
                total -= float(SIDE @ (pos[:2] - middle[:2])) + SKEW_COST * float(skew[row])
            found.append(Grasp(pos, yaw, float(opening[row]), total + 10.0 * depth))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Under:
    """All points that are near places of the hand, with the place: K pairs, of C places.

    Attributes:
        count: C.
        centre: Index of the place, (K,).
        point: Index of the point, (K,).
        x: Distance of the point along the depth of the hand, m, (K,).
        y: Where it is along the way of the fingers, (K,).
        z: Its height, (K,).
    """

    count: int
    centre: np.ndarray
    point: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray

    @classmethod
    def of(cls, flat: np.ndarray, at: np.ndarray, z: np.ndarray) -> "_Under":
        """Returns the pairs of points (P, 2), of heights (P,), and places (C, 2)."""
        order = np.argsort(flat[:, 0])  # those that are near along the depth are next to each other
        ahead = np.searchsorted(flat[order, 0], at[:, :1] + np.array([-1.0, 1.0]) * (PALM_HALF_M[0] + 1e-9))
        counts = ahead[:, 1] - ahead[:, 0]
        centre = np.repeat(np.arange(len(at)), counts)
        begins = ahead[:, 0] - (np.cumsum(counts) - counts)
        point = order[np.arange(len(centre)) + begins[centre]]
        x, y = abs(flat[point, 0] - at[centre, 0]), flat[point, 1] - at[centre, 1]
        near = (x < PALM_HALF_M[0]) & (abs(y) < PALM_HALF_M[1] + MOST_SHIFT_M)
        return cls(len(at), centre[near], point[near], x[near], y[near], z[point[near]])

    def any(self, chosen: np.ndarray) -> np.ndarray:
        """Returns at which places some pair is chosen, (C,)."""
        return np.bincount(self.centre[chosen], minlength=self.count) > 0

    def ends(self, values: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the least and the largest of the chosen values at each place, (C,); inf, -inf of none."""
        low, high = np.full(self.count, np.inf), np.full(self.count, -np.inf)
        np.minimum.at(low, self.centre[chosen], values[chosen])
        np.maximum.at(high, self.centre[chosen], values[chosen])
        return low, high

    def width(self, chosen: np.ndarray) -> np.ndarray:
        """Returns how far the chosen points reach along the way of the fingers, m, (C,); 0 without any."""
        low, high = self.ends(self.y, chosen)
        return np.maximum(high - low, 0.0)


def _openings(under: _Under, y: np.ndarray, z: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Returns how far the fingers open at each place, (C,); 0 where the hand has no room.

    Args:
        under: What is near.
        y: Distance of every point from the middle between the fingers, m, (K,).
        z: Its height over the grip site, (K,).
        width: Of what is held, (C,).
    """
    free = ~under.any((y < PALM_HALF_M[1]) & (z > PALM_M))
    finger = (under.x < FINGER_HALF_M[0] + 0.002) & (z > -TIP_BELOW_M - FREE_BELOW_M)
    opening = np.zeros(under.count)
    for wide in reversed(OPENINGS_M):  # the widest is chosen last
        room = (y > wide - 0.001) & (y < wide + 2 * FINGER_HALF_M[1] + 0.002)
        opening[free & (width / 2 + MARGIN_M <= wide) & ~under.any(finger & room)] = wide
    return opening

"""Where to push a T-shaped block that slides on a table, and how far.

The block is pushed at a point of its side that sticks to the stick. The friction of its base is taken for an
ellipsoidal limit surface (Goyal, Ruina and Papadopoulos, "Planar sliding with dry friction", Wear 143, 1991;
Lynch and Mason, "Stable pushing", IJRR 15, 1996): under a force f at r the block moves by f and turns by
(r × f) / c², up to one factor, with a length c that is the mean distance of its base from its middle.
Among all points, directions and lengths the push is taken after which the block is nearest to its goal.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from envs.rotations import wrapped

BARS = (((0.0, -0.0375), (0.1, 0.025)), ((0.0, 0.0625), (0.025, 0.075)))
"""Middle and half size of the T's two bars in its frame, m; the frame is in its centre of mass."""

LENGTH_M = 0.07
"""The limit surface's length c; an error of 1 rad counts as much as one of this length."""

CONE_RAD = 0.5
"""Largest angle between a push and the side's inward normal: well within the cone of friction, 1.0 rad."""

STEP_M, MOST_STEPS = 0.003, 40
_SPACING_M, _ANGLES = 0.0125, 7
_CORNER_M = 0.012


class Push(NamedTuple):
    """A straight push, in the world.

    Attributes:
        point: Where the side is touched, m, (2,).
        direction: Unit vector of the way, (2,).
        length_m: How far.
        normal: Unit vector out of the side, (2,).
    """

    point: np.ndarray
    direction: np.ndarray
    length_m: float
    normal: np.ndarray


@dataclass(frozen=True)
class _Options:
    """All pushes, in the block's frame, each (P, 2)."""

    points: np.ndarray
    normals: np.ndarray
    directions: np.ndarray


def _corners() -> np.ndarray:
    """Returns the corners of the T's outline, anticlockwise, (8, 2)."""
    (_, low_y), (half_x, half_y) = BARS[0]
    bottom, top = low_y - half_y, low_y + half_y
    (stem_x, stem_y), (stem_half, stem_half_y) = BARS[1]
    end = stem_y + stem_half_y
    right = [(-half_x, bottom), (half_x, bottom), (half_x, top), (stem_x + stem_half, top)]
    left = [(stem_x + stem_half, end), (stem_x - stem_half, end), (-stem_half, top), (-half_x, top)]
    return np.array([*right, *left])


def _options(clearance_m: float) -> _Options:
    """Returns pushes at points where a stick of that radius finds room."""
    corners = _corners()
    points, normals = [], []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (end - start) / np.linalg.norm(end - start)
        normal = np.array([along[1], -along[0]])
        length = float(np.linalg.norm(end - start))
        count = int((length - 2 * _CORNER_M) / _SPACING_M) + 1
        for at in np.linspace(_CORNER_M, length - _CORNER_M, count):
            place = start + at * along
            if _distance(place + normal * (clearance_m + 0.004)) >= clearance_m:
                points.append(place)
                normals.append(normal)
    turns = np.linspace(-CONE_RAD, CONE_RAD, _ANGLES)
    each = np.repeat(np.array(points), _ANGLES, axis=0), np.repeat(np.array(normals), _ANGLES, axis=0)
    return _Options(*each, _turned(-each[1], np.tile(turns, len(points))))


def _distance(place: np.ndarray) -> float:
    """Returns the distance of a point in the block's frame from the block, m."""
    gaps = [np.maximum(np.abs(place - middle) - half, 0.0) for middle, half in BARS]
    return min(float(np.linalg.norm(gap)) for gap in gaps)


def _turned(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack(
        [
            cosine * vectors[..., 0] - sine * vectors[..., 1],
            sine * vectors[..., 0] + cosine * vectors[..., 1],
        ],
        axis=-1,
    )


STICK_ROOM_M = 0.012
"""Room round the middle of the stick that a push needs beside the block, m."""

_PUSHES = _options(STICK_ROOM_M)


def moves(pos: np.ndarray, yaw: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns where each push brings the block, step by step.

    Args:
        pos: Place of the block, m, (2,).
        yaw: Its turn, rad.

    Returns:
        Places (S, P, 2) and turns (S, P) after each step, and until which step a push is one: the force
        stays inside the cone and the point sticks, (S, P) bool.
    """
    options, count = _PUSHES, len(_PUSHES.points)
    place, turn = np.tile(pos, (count, 1)), np.full(count, yaw)
    way = _turned(options.directions, turn)  # of the stick, which keeps its direction in the world
    good = np.ones(count, bool)
    places, turns, valid = [], [], []
    for _ in range(MOST_STEPS):
        arm, normal = _turned(options.points, turn), _turned(options.normals, turn)
        # way = f + (r x f) / c^2 * perp(r), a linear system for the force f.
        perp = np.stack([-arm[:, 1], arm[:, 0]], axis=1)
        matrix = np.eye(2) + perp[:, :, None] * perp[:, None, :] / LENGTH_M**2
        force = np.linalg.solve(matrix, way[..., None])[..., 0]
        inward = -(force * normal).sum(1) / np.linalg.norm(force, axis=1)
        good = good & (inward > np.cos(CONE_RAD))
        place = place + STEP_M * force
        turn = turn + STEP_M * (perp * force).sum(1) / LENGTH_M**2
        places.append(place)
        turns.append(turn)
        valid.append(good)
    return np.stack(places), np.stack(turns), np.stack(valid)


def miss(places: np.ndarray, turns: np.ndarray, goal: np.ndarray, goal_yaw: float) -> np.ndarray:
    """Returns how far poses (..., 2) and (...,) are from the goal, m."""
    off = wrapped(turns - goal_yaw)
    return np.sqrt(np.square(places - goal).sum(-1) + np.square(LENGTH_M * off))


def best_push(pos: np.ndarray, yaw: float, goal: np.ndarray, goal_yaw: float) -> Push:
    """Returns the push after which the block is nearest to its goal."""
    places, turns, valid = moves(pos, yaw)
    costs = np.where(valid, miss(places, turns, goal, goal_yaw), np.inf)
    step, index = np.unravel_index(int(costs.argmin()), costs.shape)
    options = _PUSHES
    turned = np.array(yaw)
    return Push(
        point=pos + _turned(options.points[index], turned),
        direction=_turned(options.directions[index], turned),
        length_m=STEP_M * (int(step) + 1),
        normal=_turned(options.normals[index], turned),
    )

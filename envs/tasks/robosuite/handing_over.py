"""How an arm picks up a hammer, and hands it to one that stands opposite along y."""

import math

import numpy as np

from envs.kinematics.waypoints import Waypoint, first_miss, miss
from envs.rotations import conjugate, from_matrix, multiply, rotate
from envs.state import EntityState
from envs.tasks.arm_at_table import above, point, travel_s
from envs.tasks.arms import Hand, exchanged, pointing
from envs.tasks.arms_planner import Phase
from envs.tasks.robosuite.hammer import along
from envs.tasks.skills.from_above import grasp
from envs.tasks.tabletop import GRASP_CLOSED_M, GRASP_OPEN_M

FROM_RIGHT = (0.0, -0.25, -1.0)
"""Where the right hand points when it takes the hammer."""

SIDE, MIDDLE, FAR_SIDE = 0.22, 0.06, 0.3
"""Where the hands grasp, from the middle of the handle, over its length: either one where the head is on the
giver's side, else the giver and the taker."""

HEAD_FIRST = 0.35
"""Least share of the handle's direction along y with which the head goes first to the other arm."""


def pick_up(
    hand: Hand, hammer: EntityState, length_m: float, rng: np.random.Generator, slope: float
) -> tuple[list[Waypoint], np.ndarray]:
    """Returns the way to grasp a hammer that lies, and to lift it by 0.2 m.

    Args:
        hand: The hand of the arm whose base is at negative y.
        hammer: The hammer, of a state of one row.
        length_m: Length of its handle.
        rng: Varies the way; the approach first misses.
        slope: Slope of the fingers along y.

    Returns:
        The waypoints, and the hand's orientation, wxyz, (4,), in which the handle is along y.
    """
    handle = along(hammer, 1.0) - point(hammer)
    # The end that is nearer, or the head's where both are: most of the mass is there, and turns in the hand.
    ahead = 1.0 if handle[1] > HEAD_FIRST else -1.0
    grip = along(hammer, (SIDE if ahead < 0.0 else -MIDDLE) * length_m)
    rot, met = _grips(hand, hammer, ahead, slope)
    aside = first_miss(rng, often_m=0.008, seldom_m=0.02)
    over, wide, shut = above(grip, 0.1) + aside, GRASP_OPEN_M, GRASP_CLOSED_M
    way = [
        hand.to(over, rot, wide, travel_s(hand.pos, over, 1.0)),
        *grasp(hand.to(above(grip, 0.05), rot, wide, 0.3, hold_s=0.1), grip, None),
        hand.to(above(grip, 0.2), rot, shut, 0.8),
    ]
    return way, met


def hand_over(
    giver: Hand, taker: Hand, hammer: EntityState, length_m: float, rng: np.random.Generator
) -> list[Phase]:
    """Returns phases in which the other arm, whose base is at positive y, takes a held hammer.

    Args:
        giver: The hand that holds it.
        taker: The other hand.
        hammer: The hammer, of a state of one row.
        length_m: Length of its handle.
        rng: Varies the way; the approach first misses.
    """
    handle = along(hammer, 1.0) - point(hammer)
    taken = along(hammer, (FAR_SIDE if handle[1] > 0.0 else -SIDE) * length_m)
    # The handle is square, and a grip across its edges slips: fingers close on the faces that are nearest.
    across = np.cross(handle, FROM_RIGHT)
    faces = [rotate(hammer.rot[0].numpy(), axis) for axis in np.eye(3)[:2]]
    face = max(faces, key=lambda normal: abs(float(normal @ across)))
    down = np.array(FROM_RIGHT) - float(np.dot(FROM_RIGHT, face)) * face
    rot = taker.nearer(pointing(down, face))
    back = rotate(rot, np.array([0.0, 0.0, -1.0]))
    noise = rng.normal(0.0, miss(rng, often_m=0.004, seldom_m=0.012), 3)
    away = giver.pos + 0.12 * rotate(giver.rot, np.array([0.0, 0.0, -1.0]))
    wide, shut = GRASP_OPEN_M, GRASP_CLOSED_M
    near = taker.to(taken + 0.06 * back, rot, wide, 0.3, hold_s=0.1)
    grasps = [
        taker.to(taken + 0.1 * back + noise, rot, wide, 1.0),
        *grasp(near, taken, None, down_s=0.6, hold_s=0.1),
    ]
    lets_go = [giver.to(giver.pos, giver.rot, wide, 0.3), giver.to(away, giver.rot, wide, 0.5)]
    keeps = [taker.to(above(taken, 0.05), rot, shut, 0.5)]
    return [{taker.name: grasps}, {giver.name: lets_go}, {taker.name: keeps}]


def _grips(hand: Hand, hammer: EntityState, ahead: float, slope: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns the hand's orientation, wxyz, where it grasps the hammer and where it hands it over.

    There the handle is along y, as it lies in the hand. Of all turns about that line, and of both grasps with
    exchanged fingers, those are taken that turn the hand least from one that reaches ahead.

    Args:
        hand: The hand.
        hammer: The hammer, of a state of one row.
        ahead: 1 where the head goes first, to the other robot, and -1 where the handle's end does.
        slope: Slope of its fingers along y where it grasps.
    """
    lies = hammer.rot[0].numpy()
    x, y, _ = rotate(lies, np.array([0.0, 0.0, 1.0]))
    wanted = hand.nearer(pointing((0.0, 0.3, -1.0), (1.0, 0.0, 0.0)))
    grasp = pointing((0.0, slope, -1.0), (-y, x, 0.0))
    options: list[tuple[float, np.ndarray, np.ndarray]] = []
    for rot in (grasp, exchanged(grasp)):
        held = multiply(conjugate(rot), lies)
        for angle in np.linspace(-math.pi, math.pi, 73):
            side = np.array([math.cos(angle), 0.0, math.sin(angle)])
            line = np.array([0.0, ahead, 0.0])
            turned = from_matrix(np.stack([side, np.cross(line, side), line], axis=1))
            met = multiply(turned, conjugate(held))
            options.append((abs(float(np.dot(met, wanted))), rot, met))
    _, rot, met = max(options, key=lambda option: option[0])
    return rot, met

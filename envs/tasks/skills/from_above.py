"""Waypoints of a hand that points down and knows where it goes: take, put, push with closed fingers.

Positions are those of the grip site. Ways between places are level, at a height that clears everything.
"""

from dataclasses import replace

import numpy as np

from envs.kinematics.waypoints import Waypoint, approach, correction_s, miss
from envs.tasks.skills.moves import Hand, at_height
from envs.tasks.tabletop import GRASP_CLOSED_M, GRASP_OPEN_M

OVER_M = 0.08
"""Height over a grasp from which the hand comes straight down."""

OFTEN_M, SELDOM_M = 0.008, 0.025
"""Standard deviations by which the end of a way first misses: the next motion demonstrates the correction."""

TURN_S = 0.3
"""Time for which a turn of one radian makes a motion longer."""

PUSH_M_S = 0.1
"""Mean speed of a push."""


def way_across(
    hand: Hand, now_yaw: float, over: np.ndarray, yaw: float, gripper: float, travel_z: float
) -> list[Waypoint]:
    """Returns the way up, and over to a place, at a height that clears everything.

    Args:
        hand: Where the hand is.
        now_yaw: Its turn, rad.
        over: Where it goes; a higher place is reached directly.
        yaw: Its turn there.
        gripper: Distance of each finger from the middle, m.
        travel_z: Height that clears everything, m.
    """
    high, way = max(travel_z, float(over[2])), list[Waypoint]()
    if hand.pos[2] < high - 0.01:
        up = at_height(hand.pos, high)
        way.append(hand.to(up, now_yaw, gripper))
        hand = replace(hand, pos=up)
    stop = hand.to(at_height(over, high), yaw, gripper)
    way.append(replace(stop, duration_s=stop.duration_s + TURN_S * abs(yaw - now_yaw)))
    return way


def take(
    hand: Hand,
    now_yaw: float,
    grip: np.ndarray,
    yaw: float,
    travel_z: float,
    rng: np.random.Generator,
    opening_m: float = GRASP_OPEN_M,
) -> list[Waypoint]:
    """Returns the way to a grasp, the grasp, and the way up with what is held.

    Args:
        hand: Where the hand is.
        now_yaw: Its turn, rad.
        grip: The grip site in the grasp, m, (3,).
        yaw: Turn of the hand there: at 0 fingers close along y.
        travel_z: Height that clears everything, m.
        rng: Varies the way, whose end first misses.
        opening_m: Distance of each finger from the middle before the grasp.
    """
    over = grip + np.array([0.0, 0.0, OVER_M])
    noise = np.array([*rng.normal(0.0, miss(rng, often_m=OFTEN_M, seldom_m=SELDOM_M), 2), 0.0])
    noise[2] = rng.uniform(0.0, 0.02)
    *lead, last = way_across(hand, now_yaw, over + noise, yaw, opening_m, travel_z)
    high, still = replace(hand, pos=last.pos), replace(hand, pos=grip)
    return [
        *lead,
        *approach(last, rng, SELDOM_M),
        high.to(over, yaw, opening_m),
        replace(hand, pos=over).to(grip, yaw, opening_m, hold_s=0.1),
        still.to(grip, yaw, GRASP_CLOSED_M, hold_s=0.15),
        still.to(at_height(grip, max(travel_z, float(grip[2]))), yaw, GRASP_CLOSED_M),
    ]


def put(
    hand: Hand,
    now_yaw: float,
    target: np.ndarray,
    yaw: float,
    travel_z: float,
    rng: np.random.Generator,
    opening_m: float = GRASP_OPEN_M,
) -> list[Waypoint]:
    """Returns the way of a hand that holds something to a place, letting go of it, and the way up.

    Args:
        hand: Where the hand is.
        now_yaw: Its turn, rad.
        target: The grip site where it lets go, m, (3,).
        yaw: Turn of the hand there.
        travel_z: Height that clears everything, m.
        rng: Varies the way, whose end first misses.
        opening_m: Distance of each finger from the middle when it has let go.
    """
    over = at_height(target, max(travel_z, float(target[2]) + 0.02))
    aside = rng.normal(0.0, miss(rng, often_m=OFTEN_M, seldom_m=SELDOM_M), 2)
    near = over + np.array([*aside, 0.0])
    still = replace(hand, pos=target)
    return [
        *way_across(hand, now_yaw, near, yaw, GRASP_CLOSED_M, travel_z),
        replace(hand.to(over, yaw, GRASP_CLOSED_M), duration_s=correction_s(aside) + 0.2),
        replace(hand, pos=over).to(target, yaw, GRASP_CLOSED_M, hold_s=0.15),
        still.to(target, yaw, opening_m, hold_s=0.15),
        still.to(over, yaw, opening_m),
    ]


def push(
    hand: Hand,
    now_yaw: float,
    start: np.ndarray,
    end: np.ndarray,
    yaw: float,
    travel_z: float,
    rng: np.random.Generator,
) -> list[Waypoint]:
    """Returns the way that pushes something level with closed fingers, and the way up.

    Args:
        hand: Where the hand is.
        now_yaw: Its turn, rad.
        start: Where the fingers come down, m, (3,).
        end: Where the push ends, at the same height.
        yaw: Turn of the hand.
        travel_z: Height that clears everything, m.
        rng: Varies the way and its pace.
    """
    shut, back = GRASP_CLOSED_M, start - end
    aside = 0.01 * abs(rng.normal()) * back / np.linalg.norm(back)
    first = start + aside
    push_s = 0.3 + float(np.linalg.norm(end - start)) / PUSH_M_S * rng.uniform(0.9, 1.1)
    return [
        *way_across(hand, now_yaw, at_height(first, travel_z), yaw, shut, travel_z),
        replace(hand, pos=at_height(first, travel_z)).to(first, yaw, shut),
        replace(hand, pos=first).to(start, yaw, shut),
        replace(hand.to(end, yaw, shut, hold_s=0.1), duration_s=push_s),
        replace(hand, pos=end).to(start, yaw, shut),
        replace(hand, pos=start).to(at_height(start, travel_z), yaw, shut),
    ]


def drag(
    hand: Hand,
    now_yaw: float,
    grip: np.ndarray,
    end: np.ndarray,
    yaw: float,
    travel_z: float,
    rng: np.random.Generator,
    opening_m: float = GRASP_OPEN_M,
) -> list[Waypoint]:
    """Returns the way that grasps something, moves it level to a place, lets go of it, and the way up.

    Args:
        hand: Where the hand is.
        now_yaw: Its turn, rad.
        grip: The grip site in the grasp, m, (3,).
        end: The grip site where it lets go, at the same height.
        yaw: Turn of the hand.
        travel_z: Height that clears everything, m.
        rng: Varies the way, whose end first misses, and its pace.
        opening_m: Distance of each finger from the middle before the grasp and after it.
    """
    *way, _ = take(hand, now_yaw, grip, yaw, travel_z, rng, opening_m)
    still = replace(hand, pos=end)
    drag_s = 0.4 + float(np.linalg.norm(end - grip)) / PUSH_M_S * rng.uniform(0.9, 1.1)
    return [
        *way,
        replace(hand.to(end, yaw, GRASP_CLOSED_M, hold_s=0.1), duration_s=drag_s),
        still.to(end, yaw, opening_m, hold_s=0.1),
        still.to(at_height(end, travel_z), yaw, opening_m),
    ]

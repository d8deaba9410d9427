"""Waypoints of a hand that knows where it goes: grasp, slide, take, put, push with closed fingers.

Positions are those of the grip site. :func:`grasp` and :func:`slide` keep the hand turned as it comes, and
take their times; elsewhere it points down, and its times follow from its ways. Ways between places are level,
at a height that clears everything.
Throughout, ``hand`` is where the hand is, ``yaw`` its turn at the place (at 0 its fingers close along y),
``travel_z`` that height, m, ``opening_m`` the distance of each open finger from the middle, and ``rng``
varies the way, whose end first misses, and its pace.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from envs.kinematics.waypoints import Waypoint, approach, correction_s, first_miss
from envs.tasks.arm_at_table import above
from envs.tasks.skills.hands import FINGER_HALF_M
from envs.tasks.skills.moves import Hand, at_height
from envs.tasks.tabletop import GRASP_CLOSED_M, GRASP_OPEN_M

OVER_M = 0.08
"""Height over a grasp from which the hand comes straight down."""

OFTEN_M, SELDOM_M = 0.008, 0.025
"""Standard deviations by which the end of a way first misses: the next motion demonstrates the correction."""

TURN_S = 0.3
"""Time for which a turn of one radian makes a motion longer."""

BESIDE_S = 0.2
"""Time in which a hand that came down beside a thing moves to it."""

PUSH_M_S, WIPE_M_S = 0.1, 0.12
"""Mean speeds of a push, and of wiping a surface."""


def way_across(hand: Hand, over: np.ndarray, yaw: float, gripper: float, travel_z: float) -> list[Waypoint]:
    """Returns the way up, and over to a place (3,), at a height that clears everything or higher."""
    high, way = max(travel_z, float(over[2])), list[Waypoint]()
    if hand.pos[2] < high - 0.01:
        up = at_height(hand.pos, high)
        way.append(hand.to(up, hand.yaw, gripper))
        hand = replace(hand, pos=up)
    stop = hand.to(at_height(over, high), yaw, gripper)
    way.append(replace(stop, duration_s=stop.duration_s + TURN_S * abs(yaw - hand.yaw)))
    return way


def grasp(
    over: Waypoint,
    grip: np.ndarray,
    rng: np.random.Generator | None,
    beside_m: float = 0.03,
    *,
    clear: np.ndarray | None = None,
    closed_m: float = GRASP_CLOSED_M,
    down_s: float = 0.5,
    settle_s: float = 0.1,
    close_s: float = 0.3,
    hold_s: float = 0.0,
) -> list[Waypoint]:
    """Returns the way of an open hand to about over a known place, on to it, and the grasp there.

    Args:
        over: Where it comes from, open.
        grip: The place, m, (3,).
        rng: At times the first part goes by a point beside its end; None comes straight.
        beside_m: How far beside; see :func:`~envs.kinematics.waypoints.approach`.
        clear: How far from the place the hand comes down, m, (3,), and then moves level to it: a finger that
            does not close by itself has to be brought to the thing.
        closed_m: Distance of each finger from the middle in the grasp.
        down_s: Time to the place.
        settle_s: Time to wait there.
        close_s: Time to close.
        hold_s: Time to wait then.
    """
    down = replace(over, pos=grip if clear is None else grip + clear, duration_s=down_s, hold_s=settle_s)
    there = [] if clear is None else slide(down, (grip,), (BESIDE_S,), hold_s=0.0)
    closed = replace(down, pos=grip, gripper=closed_m, duration_s=close_s, hold_s=hold_s)
    return [*([over] if rng is None else approach(over, rng, beside_m)), down, *there, closed]


def set_down(
    over: Waypoint,
    spot: np.ndarray,
    *,
    opening_m: float = GRASP_OPEN_M,
    down_s: float = 0.5,
    settle_s: float = 0.15,
    open_s: float = 0.3,
    wait_s: float = 0.0,
    rise_m: float = 0.1,
    rise_s: float = 0.5,
    hold_s: float = 0.0,
) -> list[Waypoint]:
    """Returns the way of a hand that holds something to over its place, down, letting go, and up.

    Args:
        over: Where it comes first, over the place.
        spot: Where it lets go, m, (3,).
        opening_m: Distance of each finger from the middle after it has let go.
        down_s: Time to the place.
        settle_s: Time to wait there.
        open_s: Time to let go.
        wait_s: Time to wait then.
        rise_m: How far it rises; by nothing, it stays there.
        rise_s: Time to rise.
        hold_s: Time to wait at the end.
    """
    down = replace(over, pos=spot, duration_s=down_s, hold_s=settle_s)
    opened = replace(down, gripper=opening_m, duration_s=open_s, hold_s=wait_s)
    up = replace(opened, pos=above(spot, rise_m), duration_s=rise_s, hold_s=hold_s)
    return [over, down, opened, *([up] if rise_m else [])]


def slide(
    last: Waypoint,
    places: Sequence[np.ndarray],
    seconds: Sequence[float],
    *,
    settle_s: float = 0.0,
    hold_s: float = 0.1,
) -> list[Waypoint]:
    """Returns the way of a hand along a surface or a slide, with what it pushes, holds or hooks.

    Args:
        last: Where it comes from; its turn and its fingers stay as they are there.
        places: Where it begins, where it touches if that is elsewhere, and where it ends, m, (3,) each; the
            end alone for a hand that holds something already.
        seconds: Time to reach each.
        settle_s: Time to wait where it begins.
        hold_s: Time to wait where it ends.
    """
    waits = [settle_s, *[0.0] * (len(places) - 2), hold_s][-len(places) :]
    return [
        replace(last, pos=pos, duration_s=time_s, hold_s=wait_s)
        for pos, time_s, wait_s in zip(places, seconds, waits, strict=True)
    ]


def take(
    hand: Hand,
    grip: np.ndarray,
    yaw: float,
    travel_z: float,
    rng: np.random.Generator,
    opening_m: float = GRASP_OPEN_M,
) -> list[Waypoint]:
    """Returns the way to a grasp at ``grip`` (3,), m, the grasp, and the way up with what is held."""
    over = grip + np.array([0.0, 0.0, OVER_M])
    noise = first_miss(rng, (0.0, 0.02), OFTEN_M, SELDOM_M)
    *lead, last = way_across(hand, over + noise, yaw, opening_m, travel_z)
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
    target: np.ndarray,
    yaw: float,
    travel_z: float,
    rng: np.random.Generator,
    opening_m: float = GRASP_OPEN_M,
) -> list[Waypoint]:
    """Returns the way of a hand that holds something to ``target`` (3,), m, letting go, and the way up."""
    over = at_height(target, max(travel_z, float(target[2]) + 0.02))
    aside = first_miss(rng, None, OFTEN_M, SELDOM_M)
    down_s, open_s = hand.travel_s(over, target), hand.travel_s(target, target)
    come = replace(hand.to(over, yaw, GRASP_CLOSED_M), duration_s=correction_s(aside) + 0.2)
    rise_m = float(over[2] - target[2])
    times = {"down_s": down_s, "open_s": open_s, "wait_s": 0.15, "rise_s": down_s}
    return [
        *way_across(hand, over + aside, yaw, GRASP_CLOSED_M, travel_z),
        *set_down(come, target, opening_m=opening_m, rise_m=rise_m, **times),
    ]


def push(
    hand: Hand,
    start: np.ndarray,
    end: np.ndarray,
    yaw: float,
    travel_z: float,
    rng: np.random.Generator,
) -> list[Waypoint]:
    """Returns the way of closed fingers down to ``start``, pushing level to ``end``, (3,), m, and up."""
    shut, back = GRASP_CLOSED_M, start - end
    aside = 0.01 * abs(rng.normal()) * back / np.linalg.norm(back)
    first = start + aside
    push_s = 0.3 + float(np.linalg.norm(end - start)) / PUSH_M_S * rng.uniform(0.9, 1.1)
    way = way_across(hand, at_height(first, travel_z), yaw, shut, travel_z)
    seconds = (hand.travel_s(way[-1].pos, first), hand.travel_s(first, start), push_s)
    leave = ((start, yaw, shut, 0.0), (at_height(start, travel_z), yaw, shut, 0.0))
    return [*way, *slide(way[-1], (first, start, end), seconds), *replace(hand, pos=end).chain(*leave)]


def wipe(
    hand: Hand,
    line: Sequence[np.ndarray],
    yaw: float,
    travel_z: float,
    rng: np.random.Generator,
) -> list[Waypoint]:
    """Returns the way of a tool or of closed fingers down to where a line on a surface begins, and along it.

    ``line`` has places of the grip site, m, (3,) each; those below the surface are pressed on.
    """
    over = at_height(line[0], travel_z) + first_miss(rng, (0.0, 0.02))
    *lead, come = way_across(hand, over, yaw, GRASP_CLOSED_M, travel_z)
    lengths = [float(np.linalg.norm(end - start)) for start, end in pairwise(line)]
    seconds = [max(0.1, hand.pace * length / WIPE_M_S) for length in lengths]
    along = slide(come, line, (0.3 + hand.travel_s(over, line[0]), *seconds))
    return [*lead, *approach(come, rng, SELDOM_M), *along]


def shut_drawer(
    hand: Hand,
    bar: np.ndarray,
    ahead: np.ndarray,
    out_m: float,
    yaw: float,
    travel_z: float,
    rng: np.random.Generator,
) -> list[Waypoint]:
    """Returns the way that pushes a drawer shut by its handle's bar, 18 mm thick; see :func:`push`.

    ``bar`` is its middle, m, ``ahead`` the level direction in which the drawer shuts, (3,), and ``out_m`` how
    far it is open.
    """
    start = bar - (0.009 + 2 * FINGER_HALF_M[1] + 0.02) * ahead
    return push(hand, start, start + (out_m + 0.02 + 0.006) * ahead, yaw, travel_z, rng)


def drag(
    hand: Hand,
    grip: np.ndarray,
    end: np.ndarray,
    yaw: float,
    travel_z: float,
    rng: np.random.Generator,
    opening_m: float = GRASP_OPEN_M,
) -> list[Waypoint]:
    """Returns the way that grasps something, moves it level to a place, lets go of it, and the way up.

    The grip site moves from ``grip`` to ``end``, (3,), m, at the same height.
    """
    *way, _ = take(hand, grip, yaw, travel_z, rng, opening_m)
    still = replace(hand, pos=end)
    drag_s = 0.4 + float(np.linalg.norm(end - grip)) / PUSH_M_S * rng.uniform(0.9, 1.1)
    return [
        *way,
        *slide(way[-1], (end,), (drag_s,)),
        still.to(end, yaw, opening_m, hold_s=0.1),
        still.to(at_height(end, travel_z), yaw, opening_m),
    ]

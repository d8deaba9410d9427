"""Skills at the table's parts: door, drawer, switch and button, each pushed with closed fingers."""

import numpy as np

from envs.kinematics.waypoints import Waypoint
from envs.tasks.calvin.look import UP, Look, TablePath, down, leaning
from envs.tasks.calvin_table import SCALE, SLOPE_RAD, SWITCH_TRAVEL_M, scaled

FIST_HALF_M = 0.022
"""Half the width of two closed fingers, along which they open."""

FIST_DEPTH_M = 0.011
"""Half their depth."""

OVERSHOOT_M = 0.02
"""How far beyond the end of a part's way the hand goes."""

DOOR_TILT_RAD = 0.9
DRAWER_TILT_RAD = 0.7
SWITCH_TILT_RAD = 0.95

SLOPE_UP = np.array([0.0, np.cos(SLOPE_RAD), np.sin(SLOPE_RAD)])
SLOPE_OUT = np.array([0.0, -np.sin(SLOPE_RAD), np.cos(SLOPE_RAD)])
"""Along and out of the cabinet's front."""

DOOR_BAR_M = (0.02, 0.07)
"""Half the width of the bar of the door's handle, and how far its middle is from the door's middle plane."""

DRAWER_BAR_M = (-0.25, 0.36)
"""y of the middle of the bar of a shut drawer's handle, and its height."""


def move_door(look: Look, goal: float) -> list[Waypoint]:
    """Pushes the sliding door by its handle until its joint is at ``goal``, m."""
    moved = goal - float(look.joints[0])
    sign = -np.sign(moved)  # of the way along x: the joint counts to the left
    middle = np.array(scaled((look.layout.slide + 0.175, 0.09375, 0.66908)))
    middle[0] -= look.joints[0]
    point = middle + (DOOR_BAR_M[1] - 0.012) * SLOPE_OUT
    rot = leaning(DOOR_TILT_RAD)
    beside = sign * (DOOR_BAR_M[0] + FIST_HALF_M)
    start = point - np.array([beside + sign * 0.02, 0.0, 0.0])
    end = point + np.array([sign * (abs(moved) + OVERSHOOT_M) - beside, 0.0, 0.0])
    return _push(look, rot, start, end, np.array([sign * 0.02, 0.0, 0.0]))


def move_drawer(look: Look, goal: float) -> list[Waypoint]:
    """Pulls the drawer open by its handle, or pushes it shut, until its joint is at ``goal``, m."""
    opened, x = float(look.joints[1]), look.layout.drawer * SCALE
    bar_y, bar_z = DRAWER_BAR_M
    bar_y -= opened
    if goal > opened:
        rot = leaning(DRAWER_TILT_RAD)
        start = np.array([x, bar_y + 0.034, bar_z + 0.004])
        end = start - np.array([0.0, goal - opened + OVERSHOOT_M, 0.0])
        above = start + np.array([0.0, -0.02, 0.13])
    else:
        rot = down(0.0)
        start = np.array([x, bar_y - 0.045, bar_z + 0.01])
        end = start + np.array([0.0, opened - goal + OVERSHOOT_M + 0.01, 0.0])
        above = start + np.array([0.0, 0.0, 0.2])
    back = end + np.array([0.0, 0.012 if goal > opened else -0.02, 0.0])
    return TablePath(look).over(above, rot).push(start, end, back, back + 0.15 * UP).waypoints


def push_switch(look: Look, up: bool) -> list[Waypoint]:
    """Pushes the switch up, which lights the bulb, or down."""
    x = look.layout.switch * SCALE
    frame = np.array(scaled((look.layout.switch, 0.07616, 0.61861)))
    # The bar in the switch's frame: 0.0675 out of the front, from -0.03 to 0.01 against the way up.
    bar = frame + SCALE * 0.0675 * SLOPE_OUT + (look.joints[3] + SCALE * 0.01) * SLOPE_UP
    bar[0] = x
    rot = leaning(SWITCH_TILT_RAD)
    sign = 1.0 if up else -1.0
    reach = SCALE * 0.02 + FIST_DEPTH_M
    start = bar - sign * (reach + 0.015) * SLOPE_UP - 0.004 * SLOPE_OUT
    way = (SWITCH_TRAVEL_M - look.joints[3] if up else look.joints[3]) + 0.03
    end = start + sign * way * SLOPE_UP
    return _push(look, rot, start, end, sign * 0.012 * SLOPE_UP)


def _push(
    look: Look, rot: np.ndarray, start: np.ndarray, end: np.ndarray, back: np.ndarray
) -> list[Waypoint]:
    """Pushes with closed fingers along a line, goes back a little, and withdraws as the hand came."""
    away = 0.1 * rot[:, 2]
    path = TablePath(look).over(start - away, rot)
    return path.push(start, end, end - back, end - back - away).waypoints


def press_button(look: Look) -> list[Waypoint]:
    """Presses the button once."""
    x, y, top = look.layout.button * SCALE, -0.15 * SCALE, 0.605 * SCALE
    over, start, end = (np.array([x, y, top + up]) for up in (0.1, 0.025, -0.012))
    return TablePath(look).over(over, down(0.0)).push(start, end, over, slow=2.0).waypoints

"""Waypoints of a hand: picking up, putting down, moving a joint. Positions are those of the grip site."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from envs.kinematics.waypoints import Waypoint
from envs.state import State
from envs.tasks.arm_at_table import ArmAtTable, posed
from envs.tasks.skills.clouds import Heights, Underside
from envs.tasks.skills.grasps import Grasp
from envs.tasks.skills.hands import FINGER_HALF_M, FINGER_MOST_M, TIP_BELOW_M, hand_underside
from envs.tasks.tabletop import ee_pos

CLEARANCE_M = 0.025
"""Least height over what is passed."""

CARRY_CLEARANCE_M = 0.05
"""The same for something held, which may hang lower than it was grasped: a bowl turns about its rim."""

OVER_M = 0.06
"""Height over a grasp at which the hand begins to come straight down."""

RELEASE_M = 0.006
"""Height over the first touch at which an object is let go."""

ESCAPE_TOLERANCE_M = 0.004
"""How much higher than it stands something may have to be held where nothing hangs over it."""

ESCAPE_MOST_M = 0.25

PRESS_M = 0.016
"""How far below the floor of what it drags a hand aims: fingers that press do not slip over its rim. Of 24
plates of LIBERO 22 arrive at the first attempt, of 24 bowls all."""

WALL_LEAST_M = 0.005
"""Height over that floor from which the fingers lean against a rim."""


@dataclass(frozen=True, slots=True, eq=False)
class Hand:
    """Where a hand is, and how it moves.

    Attributes:
        pos: The grip site, m, (3,).
        tilt: Pitch at which its fingers point straight down, rad.
        pace: Multiplies every duration.
        yaw: Its turn, rad.
    """

    pos: np.ndarray
    tilt: float = 0.0
    pace: float = 1.0
    yaw: float = 0.0

    @classmethod
    def of(cls, task: ArmAtTable, state: State, rng: np.random.Generator) -> "Hand":
        """Returns the hand of a task's arm in a state of one row, at a pace that is drawn."""
        arm, pace = task.arm(state), float(rng.uniform(0.9, 1.1))
        assert arm.ee_rot is not None, "a simulator gives every robot's end effector"
        pos = ee_pos(arm)[0].numpy().copy()
        yaw = posed(task.robot, pos, arm.ee_rot[0].numpy(), 0.0, 0.0).yaw
        return cls(pos, task.down_pitch_rad, pace, yaw)

    def after(self, way: Sequence[Waypoint]) -> "Hand":
        """Returns the hand at the end of a way."""
        return replace(self, pos=way[-1].pos, yaw=way[-1].yaw)

    def to(
        self, pos: np.ndarray, yaw: float, gripper: float, *, hold_s: float = 0.0, **turn: float
    ) -> Waypoint:
        """Returns a waypoint whose time follows from the way; a hand that points down unless turned."""
        angles = {"pitch": self.tilt} | turn
        seconds = self.travel_s(self.pos, pos)
        return Waypoint(pos=pos, yaw=yaw, gripper=gripper, duration_s=seconds, hold_s=hold_s, **angles)

    def travel_s(self, start: np.ndarray, end: np.ndarray) -> float:
        """Returns the time of a motion between two points, (3,), m."""
        return self.pace * (0.25 + 2.2 * float(np.linalg.norm(end - start)))

    def chain(self, *stops: tuple[np.ndarray, float, float, float]) -> list[Waypoint]:
        """Returns waypoints through stops: position, yaw, fingers, time to wait."""
        hand, way = self, []
        for pos, yaw, gripper, hold_s in stops:
            way.append(hand.to(pos, yaw, gripper, hold_s=hold_s))
            hand = replace(hand, pos=pos)
        return way


def at_height(pos: np.ndarray, z: float) -> np.ndarray:
    """Returns a position at another height."""
    return np.array([pos[0], pos[1], z])


def reach_over(
    hand: Hand, target: np.ndarray, yaw: float, opening: float, heights: Heights
) -> list[Waypoint]:
    """Returns the way of an empty hand to a place, over everything between."""
    under = hand_underside(yaw, FINGER_MOST_M)
    travel = max(heights.along(hand.pos[:2], target[:2], under) + CLEARANCE_M, float(target[2]))
    stops = []
    if hand.pos[2] < travel - 0.01:
        stops.append((at_height(hand.pos, travel), yaw, opening, 0.0))
    if np.linalg.norm(target[:2] - hand.pos[:2]) > 0.01:
        stops.append((at_height(target, max(travel, float(hand.pos[2]) - 0.1)), yaw, opening, 0.0))
    stops.append((target, yaw, opening, 0.0))
    return hand.chain(*stops)


def pick(hand: Hand, grasp: Grasp, heights: Heights) -> list[Waypoint]:
    """Returns the way to a grasp and the grasp itself.

    Args:
        hand: The hand.
        grasp: The grasp.
        heights: Everything, the object too.
    """
    above = grasp.pos + np.array([0.0, 0.0, OVER_M])
    way = reach_over(hand, above, grasp.yaw, grasp.opening_m, heights)
    at = replace(hand, pos=above)
    down = at.to(grasp.pos, grasp.yaw, grasp.opening_m, hold_s=0.1)
    still = replace(hand, pos=grasp.pos)
    return [*way, down, still.to(grasp.pos, grasp.yaw, 0.0, hold_s=0.2)]


def escape(grasp: Grasp, carried: Underside, heights: Heights) -> np.ndarray:
    """Returns the shortest level way (2,) of something held to where nothing hangs over it, or none at all.

    Args:
        grasp: The grasp.
        carried: Underside of what is held and of the hand.
        heights: Everything but what is held.
    """
    free = float(grasp.pos[2]) + ESCAPE_TOLERANCE_M
    if float(heights.rest(grasp.pos[None, :2], carried)[0]) <= free:
        return np.zeros(2)
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for length in np.arange(0.02, ESCAPE_MOST_M, 0.02):
        clear = heights.rest(grasp.pos[:2] + length * rays, carried) <= free
        if clear.any():
            return length * _middle(rays[clear])
    return np.zeros(2)


def _middle(rays: np.ndarray) -> np.ndarray:
    """Returns the ray (2,) that is nearest to the mean of rays (n, 2)."""
    return rays[int((rays @ rays.mean(0)).argmax())]


def drag(hand: Hand, points: np.ndarray, way: np.ndarray, heights: Heights, over: Heights) -> list[Waypoint]:
    """Returns the way that drags a flat, hollow thing, such as a plate.

    Closed fingers press on its floor, go to its rim and take it along.

    Args:
        hand: The hand.
        points: The thing, (P, 3), m.
        way: How far it is to go, m, (2,).
        heights: Everything.
        over: The thing alone.
    """
    middle = (points[:, :2].min(0) + points[:, :2].max(0)) / 2
    along = way / np.linalg.norm(way)
    yaw = float(np.arctan2(along[1], along[0]))
    yaw = (yaw + np.pi / 2) % np.pi - np.pi / 2
    fist = hand_underside(yaw, 0.0)
    rests = float(over.rest(middle[None], fist)[0])
    ahead = points[:, :2] - middle
    wall = (np.abs(ahead @ np.array([-along[1], along[0]])) < 0.02) & (
        points[:, 2] > rests - TIP_BELOW_M + WALL_LEAST_M
    )
    reach = ahead[wall] @ along
    inner = float(reach[reach > 0.01].min()) if (reach > 0.01).any() else 0.0
    inside, low = max(inner - FINGER_HALF_M[0], 0.0) * along, rests - PRESS_M
    start = np.array([*middle, low])
    end = np.array([*(middle + way + inside), low])
    above = start + np.array([0.0, 0.0, OVER_M])
    lead = reach_over(hand, above, yaw, 0.0, heights)
    stops = ((start, yaw, 0.0, 0.1), (end, yaw, 0.0, 0.2), (end + np.array([0.0, 0.0, 0.1]), yaw, 0.0, 0.0))
    return [*lead, *replace(hand, pos=above).chain(*stops)]


def put(
    hand: Hand, grasp: Grasp, carried: Underside, target: np.ndarray, yaw: float, heights: Heights
) -> list[Waypoint]:
    """Returns the way of a hand that holds something to a place, and letting go.

    Args:
        hand: The hand, at the grasp.
        grasp: The grasp.
        carried: Underside of what it holds and of the hand.
        target: Grip site where it lets go, m, (3,).
        yaw: Turn of the hand there, rad.
        heights: Everything but what it holds.
    """
    aside = grasp.pos + np.array([*escape(grasp, carried, heights), ESCAPE_TOLERANCE_M])
    travel = heights.along(aside[:2], target[:2], carried) + CARRY_CLEARANCE_M
    travel = max(travel, float(grasp.pos[2]) + 0.05, float(target[2]) + 0.02)
    stops = (
        *(((aside, grasp.yaw, 0.0, 0.0),) if (aside[:2] != grasp.pos[:2]).any() else ()),
        (at_height(aside, travel), grasp.yaw, 0.0, 0.0),
        (at_height(target, travel), yaw, 0.0, 0.1),
        (target, yaw, 0.0, 0.15),
        (target, yaw, grasp.opening_m, 0.35),
        (target + np.array([0.0, 0.0, 0.08]), yaw, grasp.opening_m, 0.0),
    )
    return replace(hand, pos=grasp.pos).chain(*stops)


def follow(hand: Hand, stops: Sequence[Waypoint]) -> list[Waypoint]:
    """Returns stops with the times that their distances ask for."""
    way, pos = [], hand.pos
    for stop in stops:
        length = float(np.linalg.norm(stop.pos - pos))
        way.append(replace(stop, duration_s=hand.pace * (stop.duration_s + 2.2 * length)))
        pos = stop.pos
    return way

"""Tasks of an SO-101 with cubes of 3 cm: lift one, stack two, push one onto a target."""

from dataclasses import dataclass
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import concatenate, norm, where, within
from envs.kinematics.waypoints import Waypoint, grasp_yaw, miss
from envs.scenario import GeomCfg, ObjectCfg, Rgba
from envs.state import State
from envs.tasks.arm_at_table import Start, heading, point, travel_s
from envs.tasks.skills.from_above import put, slide
from envs.tasks.skills.moves import Hand
from envs.tasks.so101.scene import CLOSED_M, HIGH_M, LOW_M, OPEN_M, RISE_M, So101Task, beside, lifted, take
from envs.tasks.tabletop import distance, ee_pos, finger_gap, flat_distance, is_held, nearness, target_gap

HALF_M = 0.015
"""Half a cube's edge: the jaw opens to 54 mm."""

_MASS_KG = 0.027
_RED: Rgba = (0.85, 0.08, 0.08, 1.0)
_GREEN: Rgba = (0.08, 0.7, 0.12, 1.0)

REACH_M = (0.17, 0.24)
"""Distances from the base at which cubes start."""

SIDE_RAD = 0.45
"""Largest angle, seen from the base, between a cube and the direction that the arm faces."""


def cube(name: str, rgba: Rgba, x: float) -> ObjectCfg:
    """Returns a cube of 3 cm and of ManiSkill's default density, 1000 kg/m³."""
    geom = GeomCfg(shape="box", size=(HALF_M,) * 3, mass_kg=_MASS_KG, rgba=rgba)
    return ObjectCfg(name=name, geoms=(geom,), pos=(x, 0.0, HALF_M))


def draw_place(rng: np.random.Generator, reach_m: tuple[float, float] = REACH_M) -> np.ndarray:
    """Draws a place on the table within the arm's reach, (3,), m: the middle of a cube that lies there."""
    far, side = rng.uniform(*reach_m), rng.uniform(-SIDE_RAD, SIDE_RAD)
    return np.array([far * np.cos(side), far * np.sin(side), HALF_M])


def hold_point(pos: np.ndarray) -> np.ndarray:
    """Returns where the grip site is when the hand holds a cube, m, (3,)."""
    return np.array([pos[0], pos[1], pos[2] + LOW_M - HALF_M])


@dataclass(frozen=True, kw_only=True)
class PickCube(So101Task):
    """Grasp the red cube and lift it.

    Attributes:
        lift_m: Height above its start at which the cube counts as lifted.
        approach_noise_m: Standard deviation of where the expert begins to come down on the cube.
        near_noise_m: Standard deviation of where it is once more off, just above the cube: its correction is
            what a policy must do there, for the open hand fits over the cube within 8 mm.
        turn_miss_rad: Largest angle by which the hand is turned wrongly above the cube, in half of the
            episodes. The expert takes the smaller of two good turns, and a policy that sees a cube halfway
            between them makes neither; from the correction it learns to turn to the nearer one.
    """

    name: ClassVar[str] = "so101/pick_cube"
    instructions: ClassVar[tuple[str, ...]] = (
        "pick up the red cube",
        "grasp the red cube and lift it",
        "lift the red cube off the table",
    )
    max_episode_steps: ClassVar[int] = 180

    lift_m: float = 0.04
    approach_noise_m: float = 0.008
    near_noise_m: float = 0.0
    turn_miss_rad: float = 0.0

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (cube("cube", _RED, 0.2),)

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        return {"cube": Start(draw_place(rng), rng.uniform(-np.pi, np.pi))}

    @override
    def success(self, state: State) -> Tensor:
        pos = state.objects["cube"].pos
        return (pos[:, 2] >= HALF_M + self.lift_m) & self._held(state)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns the mean of being near, holding and height, (N,)."""
        pos = state.objects["cube"].pos
        reached = nearness(distance(ee_pos(self.arm(state)), pos))
        height = within((pos[:, 2] - HALF_M) / self.lift_m, 0.0, 1.0)
        held = 1.0 * self._held(state)
        return 0.33 * (reached + held + held * height)

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the cube's pose, the hand, and the way between them, (N, 13)."""
        item, hand = state.objects["cube"], ee_pos(self.arm(state))
        return concatenate((item.pos, item.rot, hand, item.pos - hand))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        pos = point(state.objects["cube"])
        yaw = grasp_yaw(heading(state.objects["cube"]))
        hand = ee_pos(self.arm(state))[0].numpy()
        spread = miss(rng, often_m=self.approach_noise_m, seldom_m=0.025)
        above = lifted(pos + np.array([*rng.normal(0.0, spread, 2), 0.0]), rng.uniform(0.055, 0.07))
        middle = hold_point(pos)
        up = lifted(middle, middle[2] + self.lift_m + 0.01)
        off = rng.normal(0.0, self.near_noise_m, 2) if self.near_noise_m else None
        turned = 0.0
        if self.turn_miss_rad and rng.uniform() < 0.5:
            turned = rng.uniform(-self.turn_miss_rad, self.turn_miss_rad)
        come_s = travel_s(hand, above, 0.4) + 0.4 * abs(turned)
        come = Waypoint(pos=above, yaw=yaw + turned, gripper=OPEN_M, duration_s=come_s)
        return [
            *self.rise(state, RISE_M),
            *take(come, beside(middle, HALF_M, yaw), yaw, off),
            Waypoint(pos=up, yaw=yaw, gripper=CLOSED_M, duration_s=0.7, hold_s=0.2),
        ]

    def _held(self, state: State) -> Tensor:
        return is_held(self.arm(state), state.objects["cube"].pos, 0.025, 2 * HALF_M, self.robot)


@dataclass(frozen=True, kw_only=True)
class StackCube(So101Task):
    """Put the red cube on the green cube and let go of it."""

    name: ClassVar[str] = "so101/stack_cube"
    instructions: ClassVar[tuple[str, ...]] = (
        "stack the red cube on the green cube",
        "put the red cube on top of the green cube",
        "place the red cube on the green one and let go of it",
    )
    max_episode_steps: ClassVar[int] = 300

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return cube("red", _RED, 0.18), cube("green", _GREEN, 0.24)

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        red, green = draw_place(rng), draw_place(rng, (0.17, 0.22))
        while np.linalg.norm(red - green) < 0.085:  # the open hand fits between them
            red, green = draw_place(rng), draw_place(rng, (0.17, 0.22))
        turns = rng.uniform(-np.pi, np.pi, 2)
        return {"red": Start(red, turns[0]), "green": Start(green, turns[1])}

    @override
    def success(self, state: State) -> Tensor:
        red = state.objects["red"]
        still = (norm(red.lin_vel) <= 0.02) & (norm(red.ang_vel) <= 0.5)
        return self._on_top(state) & still & self._released(state)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns the mean of being near, holding, being near the place, and letting go there, (N,)."""
        red, green = state.objects["red"].pos, state.objects["green"].pos
        reached = nearness(distance(ee_pos(self.arm(state)), red))
        held = 1.0 * self._held(state)
        goal = norm(red[:, :2] - green[:, :2]) + abs(red[:, 2] - green[:, 2] - 2 * HALF_M)
        on_top = self._on_top(state)
        before = reached + held + held * nearness(goal)
        return 0.24 * where(on_top, 3.0 + 1.0 * self._released(state), before)

    @override
    def observe(self, state: State) -> Tensor:
        """Returns both cubes' poses, the hand, and the ways between the three, (N, 26)."""
        a, b, hand = state.objects["red"], state.objects["green"], ee_pos(self.arm(state))
        return concatenate((a.pos, a.rot, b.pos, b.rot, hand, a.pos - hand, b.pos - hand, b.pos - a.pos))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        red, green = point(state.objects["red"]), point(state.objects["green"])
        if bool(self._on_top(state)[0]):
            return self.rise(state, 0.08)
        yaw = grasp_yaw(heading(state.objects["red"]))
        hand = ee_pos(self.arm(state))[0].numpy()
        spread = miss(rng, often_m=0.006, seldom_m=0.015)
        above = lifted(red + np.array([*rng.normal(0.0, spread, 2), 0.0]), rng.uniform(0.06, 0.07))
        come = Waypoint(pos=above, yaw=yaw, gripper=OPEN_M, duration_s=travel_s(hand, above, 0.4))
        way = [*self.rise(state, RISE_M), *take(come, beside(hold_point(red), HALF_M, yaw), yaw)]
        place = hold_point(green) + way[-1].pos - hold_point(red) + np.array([0.0, 0.0, 2 * HALF_M + 0.001])
        return [*way, *put(Hand.of(self, state, rng).after(way), place, yaw, HIGH_M, rng, OPEN_M)]

    def _held(self, state: State) -> Tensor:
        return is_held(self.arm(state), state.objects["red"].pos, 0.025, 2 * HALF_M, self.robot)

    def _released(self, state: State) -> Tensor:
        arm = self.arm(state)
        apart = distance(ee_pos(arm), state.objects["red"].pos) > 2.5 * HALF_M
        opened = finger_gap(arm, self.robot) > 2 * HALF_M + 0.008
        return apart | (opened & (target_gap(arm, self.robot) > 2 * HALF_M))

    def _on_top(self, state: State) -> Tensor:
        red, green = state.objects["red"].pos, state.objects["green"].pos
        off = red[:, 2] - green[:, 2] - 2 * HALF_M
        return (flat_distance(red, green) <= HALF_M) & (abs(off) <= 0.005)


@dataclass(frozen=True, kw_only=True)
class PushCube(So101Task):
    """Push the red cube onto the target.

    Attributes:
        tolerance_m: Distance of the cube's middle from the target's at which it is there.
    """

    name: ClassVar[str] = "so101/push_cube"
    instructions: ClassVar[tuple[str, ...]] = (
        "push the red cube onto the green target",
        "move the red cube to the green target by pushing it",
        "push the red cube away until it is on the green target",
    )
    max_episode_steps: ClassVar[int] = 240

    tolerance_m: float = 0.02

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        disc = GeomCfg(shape="cylinder", size=(0.03, 0.0005), rgba=_GREEN)
        target = ObjectCfg(name="target", geoms=(disc,), pos=(0.25, 0.0, 0.0005), kind="marker")
        return cube("cube", _RED, 0.18), target

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        pos = draw_place(rng, (0.165, 0.19))
        way = np.arctan2(pos[1], pos[0]) + rng.uniform(-0.4, 0.4)
        goal = pos + rng.uniform(0.05, 0.07) * np.array([np.cos(way), np.sin(way), 0.0])
        return {
            "cube": Start(pos, way + rng.uniform(-0.3, 0.3)),
            "target": Start((goal[0], goal[1], 0.0005)),
        }

    @override
    def success(self, state: State) -> Tensor:
        still = norm(state.objects["cube"].lin_vel) <= 0.05
        return (self._left(state) <= self.tolerance_m) & still

    @override
    def reward(self, state: State) -> Tensor:
        """Returns the mean of being near the cube and of its being near the target, (N,)."""
        reached = nearness(distance(ee_pos(self.arm(state)), state.objects["cube"].pos))
        return 0.3 * reached + 0.6 * nearness(self._left(state), 15.0)

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the cube's pose, the target, the hand, and the ways between the three, (N, 22)."""
        item, goal, hand = state.objects["cube"], state.objects["target"].pos, ee_pos(self.arm(state))
        return concatenate((item.pos, item.rot, goal, hand, item.pos - hand, goal - item.pos, goal - hand))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        pos, goal = point(state.objects["cube"]), point(state.objects["target"])
        left = goal[:2] - pos[:2]
        ahead = np.array([*(left / max(float(np.linalg.norm(left)), 1e-6)), 0.0])
        yaw = float(np.arctan2(ahead[1], ahead[0]))
        low = np.array([pos[0], pos[1], LOW_M + 0.002])
        behind = low - (_TOUCHING_M + rng.uniform(0.015, 0.02)) * ahead
        hand = ee_pos(self.arm(state))[0].numpy()
        end = np.array([goal[0], goal[1], low[2]]) - (_TOUCHING_M - rng.uniform(0.0, 0.004)) * ahead
        push_s = 0.5 + 8.0 * float(np.linalg.norm(end - behind))
        high = lifted(behind, rng.uniform(0.055, 0.065))
        over = Waypoint(pos=high, yaw=yaw, gripper=CLOSED_M, duration_s=travel_s(hand, high, 0.5))
        way = slide(over, (behind, end), (0.5, push_s), hold_s=0.3)
        return [*self.rise(state, RISE_M), over, *way]

    def _left(self, state: State) -> Tensor:
        """Returns how far the cube is from the target, (N,), m."""
        return flat_distance(state.objects["cube"].pos, state.objects["target"].pos)


_TOUCHING_M = HALF_M - 0.007
"""Distance of the grip site behind a cube's middle when closed fingers touch it: the jaw's outer face is 7 mm
nearer to the base than the site."""

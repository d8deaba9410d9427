"""TwoRobotPickCube and TwoRobotStackCube, after ManiSkill 3 (``tabletop/two_robot_*_cube.py``).

Two Pandas face each other across the table (``scene_builder/table/scene_builder.py``). The rewards are
ManiSkill's dense ones, without the terms on the height of single fingertips; its grasp test reads contact
forces, which a state does not have: here a cube is grasped when it keeps closing fingers apart.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, at_least, concatenate, constant, norm, where
from envs.kinematics.waypoints import Waypoint, first_miss, grasp_yaw
from envs.robots.franka import FRANKA
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, RobotCfg, TableCfg
from envs.state import EntityState, State
from envs.tasks.arm_at_table import Start, above, heading, point, travel_s
from envs.tasks.arms import ArmsAtTable, Hand, downward, facing, pointing
from envs.tasks.arms_planner import Phase
from envs.tasks.maniskill.parts import BLUE, CUBE_HALF_SIZE_M, GOAL_Z_M, GREEN, RED, cube, target
from envs.tasks.robot_columns import columns_of
from envs.tasks.skills.from_above import grasp, set_down
from envs.tasks.tabletop import (
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    STATIC_SPEED_RAD_S,
    arm_speed,
    distance,
    ee_pos,
    finger_gap,
    flat_distance,
    is_held,
    nearness,
)

_CUBES = (("cube_a", BLUE), ("cube_b", GREEN))

BASE_Y_M = 0.75
LEFT = facing(FRANKA, "franka_left", (0.0, -BASE_Y_M, 0.0), math.pi / 2)
RIGHT = facing(FRANKA, "franka_right", (0.0, BASE_Y_M, 0.0), -math.pi / 2)

GRASP_REACH_M = 0.03
HALF_OPEN_M = 0.034
"""Opening of a hand that lets go of a cube: it keeps off what stands beside it."""

PUT_M = 0.002
"""Height above its place at which a cube is let go."""

AWAY_M = 0.2
"""Distance from the middle line at which a hand is out of the other's way."""


@dataclass(frozen=True, kw_only=True)
class TwoRobots(ArmsAtTable):
    """Two Pandas that face each other along y.

    Attributes:
        cube_half_size_m: Half the side of a cube.
        spawn_x_m: Range of x in which cubes start and goals are.
        spawn_y_m: Range of the distance of a start from the middle line y = 0.
    """

    own_robots: ClassVar[tuple[RobotCfg, ...]] = (LEFT, RIGHT)
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, look_at=(0.0, 0.0, 0.16), fovy_deg=40.0)
    table: ClassVar[TableCfg] = TableCfg(pos=(-0.12, 0.0, 0.0), half_size=(0.6045, 1.209), height_m=0.9196)

    cube_half_size_m: float = CUBE_HALF_SIZE_M
    spawn_x_m: tuple[float, float] = (-0.05, 0.05)
    spawn_y_m: tuple[float, float] = (0.1, 0.2)

    def place(self, rng: np.random.Generator, side: float) -> np.ndarray:
        """Draws a place on the left (-1) or right (1) half of the table, m, (2,)."""
        return np.array([rng.uniform(*self.spawn_x_m), side * rng.uniform(*self.spawn_y_m)])

    def held(self, state: State, index: int, item: EntityState) -> Array:
        """Returns whether a robot's fingers hold a cube, (N,)."""
        robot = self.robots[index]
        width = 2 * self.cube_half_size_m
        return is_held(state.robots[robot.name], item.pos, GRASP_REACH_M, width, cfg=robot)

    def grasp(
        self, hand: Hand, item: EntityState, rng: np.random.Generator, ahead: float = 0.0
    ) -> list[Waypoint]:
        """Returns the way to grasp a cube; the approach first misses, for the next motion to correct.

        Args:
            hand: The hand.
            item: The cube.
            rng: Varies the way.
            ahead: Slope of the fingers along y, which lengthens the arm's reach.
        """
        start, turn = point(item), grasp_yaw(heading(item))
        rot = hand.nearer(pointing((0.0, ahead, -1.0), (np.cos(turn), np.sin(turn), 0.0)))
        noise = first_miss(rng, (0.07, 0.1))
        over = hand.to(start + noise, rot, GRASP_OPEN_M, travel_s(hand.pos, start + noise, 0.6))
        return grasp(over, start, None, close_s=0.25)

    def put_down(self, last: Waypoint, spot: np.ndarray, height_m: float) -> list[Waypoint]:
        """Returns the way of a held cube to a place, and of the hand back up; nothing is turned.

        Args:
            last: Where it was grasped.
            spot: Where the cube's centre goes, m, (3,).
            height_m: Height above the table in which it travels.
        """
        lift, over = above(last.pos, height_m), above(spot, height_m)
        come = replace(last, pos=over, duration_s=travel_s(lift, over))
        return [replace(last, pos=lift, duration_s=0.4), *_put(come, spot)]

    def withdrawn(self, index: int, x_m: float, opening_rad: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Returns the pose of a hand that is out of the other's way."""
        side = -1.0 if index == 0 else 1.0
        return np.array([x_m, side * AWAY_M, 0.2]), downward(opening_rad)


def _put(over: Waypoint, spot: np.ndarray) -> list[Waypoint]:
    """Returns the way of a held cube from over its place (3,), m, to there, and of the hand back up."""
    times = {"settle_s": 0.1, "open_s": 0.25, "rise_s": 0.4}
    return set_down(over, above(spot, PUT_M), opening_m=HALF_OPEN_M, rise_m=0.08 - PUT_M, **times)


@dataclass(frozen=True, kw_only=True)
class TwoRobotPickCube(TwoRobots):
    """The left robot hands a cube over the middle, the right one lifts it to a goal.

    Attributes:
        goal_height_m: Range of the goal's height above the cube's start.
        goal_radius_m: Largest distance of the cube from the goal.
        static_speed_rad_s: Largest speed of a joint of the right arm that is still.
    """

    name: ClassVar[str] = "TwoRobotPickCube"
    instructions: ClassVar[tuple[str, ...]] = (
        "move the red cube from the left side to the green goal on the right side",
        "pass the cube to the right robot, which lifts it to the goal",
        "bring the cube to the green ball with both arms and hold it there",
    )
    max_episode_steps: ClassVar[int] = 250

    goal_height_m: tuple[float, float] = (0.0, 0.3)
    goal_radius_m: float = 0.025
    static_speed_rad_s: float = STATIC_SPEED_RAD_S

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        ball = GeomCfg(shape="sphere", size=(self.goal_radius_m,), rgba=(0.1, 0.8, 0.2, 0.5))
        goal = ObjectCfg(name="goal", geoms=(ball,), pos=(0.0, 0.15, 0.15), kind="marker")
        return (cube("cube", self.cube_half_size_m, RED), goal)

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        start, goal = self.place(rng, -1.0), self.place(rng, 1.0)
        height = self.cube_half_size_m + rng.uniform(*self.goal_height_m)
        return {
            "cube": Start((*start, self.cube_half_size_m), rng.uniform(-np.pi, np.pi)),
            "goal": Start((*goal, height)),
        }

    @override
    def success(self, state: State) -> Tensor:
        right = self.robots[1]
        still = arm_speed(state.robots[right.name], right) <= self.static_speed_rad_s
        return self._placed(state) & still

    @override
    def reward(self, state: State) -> Tensor:
        """Returns ManiSkill's stages: hand over, reach, grasp, lift and keep still; over 15."""
        item, goal = state.objects["cube"].pos, state.objects["goal"].pos
        robot = self.robots[1]
        left, right = (state.robots[each.name] for each in self.robots)
        across = nearness(at_least(0.05 - item[:, 1], 0.0))
        first = 0.5 * (nearness(distance(ee_pos(left), item)) + across)
        open_fingers = nearness(abs(finger_gap(right, robot) - 0.07))
        leave = nearness(abs(ee_pos(left)[:, 1] + AWAY_M))
        held = self.held(state, 1, state.objects["cube"])
        second = 2.0 + nearness(distance(ee_pos(right), item)) + open_fingers + leave + 2.0 * held
        far = distance(ee_pos(right), goal)
        third = where(far < 0.25, 10.0 + 2.0 * nearness(far), 8.0 + nearness(far))
        still = nearness(norm(right.joint_vel[:, columns_of(robot).arm]))
        reached = where(item[:, 1] >= 0.0, second, first)
        return where(self._placed(state), 13.0 + still, where(held, third, reached)) / 15.0

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the cube's pose, goal, end effectors, and ways between them, (N, 25)."""
        item, goal = state.objects["cube"], state.objects["goal"].pos
        hands = [ee_pos(state.robots[robot.name]) for robot in self.robots]
        ways = (item.pos - hands[0], item.pos - hands[1], goal - item.pos)
        return concatenate((item.pos, item.rot, goal, *hands, *ways))

    @override
    def phases(self, state: State, rng: np.random.Generator) -> list[Phase]:
        item, goal = state.objects["cube"], point(state.objects["goal"])
        left, right = self.hand(state, 0), self.hand(state, 1)
        if bool(self.held(state, 1, item)[0]):
            corrected = goal + right.pos - point(item)
            return [{right.name: [right.to(corrected, right.rot, GRASP_CLOSED_M, 0.6, hold_s=0.3)]}]
        phases: list[Phase] = []
        away, rot = self.withdrawn(0, -0.02)
        leaves = [left.to(away, left.nearer(rot), GRASP_OPEN_M, 0.7)]
        waits, across = self.withdrawn(1, point(item)[0])
        place, turn = point(item), grasp_yaw(heading(item))
        if place[1] < -0.06:
            place = np.array([rng.uniform(-0.04, 0.04), rng.uniform(-0.015, 0.015), self.cube_half_size_m])
            taken = self.grasp(left, item, rng)
            ready = [right.to(waits, right.nearer(across), GRASP_OPEN_M, 1.0)]
            phases.append({left.name: [*taken, *self.put_down(taken[-1], place, 0.1)], right.name: ready})
        rot = right.nearer(downward(turn))
        over = above(place, 0.1) + first_miss(rng)
        come = right.to(over, rot, GRASP_OPEN_M, travel_s(waits, over, 0.6))
        takes = [
            *grasp(come, place, None, down_s=0.6, close_s=0.25),
            right.to(above(place, 0.03), rot, GRASP_CLOSED_M, 0.3),
            right.to(goal, rot, GRASP_CLOSED_M, travel_s(place, goal, 0.5), hold_s=0.2),
        ]
        return [*phases, {left.name: leaves, right.name: takes}]

    def _placed(self, state: State) -> Array:
        return distance(state.objects["cube"].pos, state.objects["goal"].pos) <= self.goal_radius_m


@dataclass(frozen=True, kw_only=True)
class TwoRobotStackCube(TwoRobots):
    """The right robot puts the green cube on a target, the left one the blue cube on the green one.

    Attributes:
        goal_radius_m: Radius of the target, in which the green cube's centre has to be.
        goal_y_m: Distance of the target from the middle line.
        tolerance_m: Added to half the diagonal of a cube's face, and limit of a gap's height.
    """

    name: ClassVar[str] = "TwoRobotStackCube"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the green cube on the target and stack the blue cube on it",
        "place the green cube on the red and white disc, then the blue cube on top",
        "stack the blue cube on the green one on the target and let go of both",
    )
    max_episode_steps: ClassVar[int] = 300

    goal_radius_m: float = 0.06
    goal_y_m: float = 0.1
    tolerance_m: float = 0.005

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        cubes = (cube(name, self.cube_half_size_m, rgba) for name, rgba in _CUBES)
        return (*cubes, target("goal", self.goal_radius_m))

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        a, b = self.place(rng, -1.0), self.place(rng, 1.0)
        yaws, goal_x = rng.uniform(-np.pi, np.pi, 2), rng.uniform(*self.spawn_x_m)
        return {
            "cube_a": Start((*a, self.cube_half_size_m), yaws[0]),
            "cube_b": Start((*b, self.cube_half_size_m), yaws[1]),
            "goal": Start((goal_x, -self.goal_y_m, GOAL_Z_M)),
        }

    @override
    def success(self, state: State) -> Tensor:
        a, b = state.objects["cube_a"], state.objects["cube_b"]
        let_go = ~self.held(state, 0, a) & ~self.held(state, 1, b)
        return self._on_top(state) & self._on_target(state) & let_go

    @override
    def reward(self, state: State) -> Tensor:
        """Returns ManiSkill's stages: grasp, place the lower cube, place the upper one, let go; over 10."""
        a, b = state.objects["cube_a"], state.objects["cube_b"]
        left, right = (state.robots[each.name] for each in self.robots)
        held_a, held_b = self.held(state, 0, a), self.held(state, 1, b)
        push = b.pos + constant((0.0, self.cube_half_size_m + 0.005, 0.0), b.pos)
        reach = 0.5 * (nearness(distance(ee_pos(left), a.pos)) + nearness(distance(ee_pos(right), push)))
        first = 0.5 * (reach + held_a)
        goal = state.objects["goal"].pos
        second = 2.0 + 0.5 * (nearness(flat_distance(b.pos, goal)) + 1.0)
        top = b.pos + constant((0.0, 0.0, 2 * self.cube_half_size_m), b.pos)
        leave = nearness(abs(ee_pos(right)[:, 1] - AWAY_M))
        third = 4.0 + 2.0 * nearness(distance(a.pos, top)) + leave
        gaps = [
            finger_gap(arm, each) / each.opening_m
            for arm, each in ((left, self.robots[0]), (right, self.robots[1]))
        ]
        opened = where(held_a, gaps[0], 1.0) + where(held_b, gaps[1], 1.0)
        placed = self._on_target(state)
        stage = where(held_a, where(placed, third, second), first)
        return where(self._on_top(state) & placed, 8.0 + 0.5 * opened, stage) / 10.0

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the cubes' poses, target, end effectors, and ways between them, (N, 32)."""
        a, b, goal = state.objects["cube_a"], state.objects["cube_b"], state.objects["goal"].pos
        hands = [ee_pos(state.robots[robot.name]) for robot in self.robots]
        ways = (a.pos - hands[0], b.pos - hands[1], b.pos - a.pos)
        return concatenate((a.pos, a.rot, b.pos, b.rot, goal, *hands, *ways))

    @override
    def phases(self, state: State, rng: np.random.Generator) -> list[Phase]:
        a, b = state.objects["cube_a"], state.objects["cube_b"]
        left, right = self.hand(state, 0), self.hand(state, 1)
        half, goal = self.cube_half_size_m, point(state.objects["goal"])
        place = point(b)
        away, across = self.withdrawn(1, goal[0])
        leaves = right.to(away, right.nearer(across), GRASP_OPEN_M, 0.8)
        picks = self.grasp(left, a, rng)
        lifted = [replace(picks[-1], pos=above(point(a), 0.12), duration_s=0.4)]
        if bool(self._on_target(state)[0]):
            phases: list[Phase] = [{left.name: [*picks, *lifted], right.name: [leaves]}]
        else:
            # As near to its robot as the target allows.
            place = np.array([goal[0], goal[1] + rng.uniform(0.03, 0.045), half])
            takes = self.grasp(right, b, rng, ahead=-0.3)
            # The blue cube may start where the green one goes: it is lifted out of the way first.
            aside = [replace(lifted[0], pos=np.array([goal[0], -0.3, 0.2]), duration_s=0.6)]
            moves = self.put_down(takes[-1], place, 0.1)
            phases = [{left.name: [*picks, *lifted, *aside]}, {right.name: [*takes, *moves, leaves]}]
        top = above(place, 2 * half)
        missed = above(top, 0.08) + first_miss(rng, often_m=0.008, seldom_m=0.02)
        come = replace(picks[-1], pos=above(top, 0.06), duration_s=0.3, hold_s=0.1)
        stacks = [replace(come, pos=missed, duration_s=0.8, hold_s=0.0), *_put(come, top)]
        return [*phases, {left.name: stacks}]

    def _on_top(self, state: State) -> Array:
        off = state.objects["cube_a"].pos - state.objects["cube_b"].pos
        most = math.sqrt(2.0) * self.cube_half_size_m + self.tolerance_m
        return (norm(off[:, :2]) <= most) & (abs(off[:, 2] - 2 * self.cube_half_size_m) <= self.tolerance_m)

    def _on_target(self, state: State) -> Array:
        return flat_distance(state.objects["cube_b"].pos, state.objects["goal"].pos) < self.goal_radius_m

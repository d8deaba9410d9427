"""LiftPegUpright and PokeCube, after ManiSkill 3 (``tabletop/lift_peg_upright.py``, ``poke_cube.py``).

ManiSkill has no dense reward for LiftPegUpright; ours is reach, grasp, turn, set down. It reads the turn as
the third Euler angle of the peg, which leaves out turns about the world's x axis; here it is the angle
between the peg and the vertical.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, constant, where
from envs.kinematics.waypoints import Waypoint, first_miss
from envs.rotations import rotate, yaw_of
from envs.scenario import CameraCfg, ObjectCfg, Rgba
from envs.state import EntityState, State
from envs.tasks.arm_at_table import ArmAtTable, Start, above, heading, point, tip_to_reach, travel_s, way
from envs.tasks.maniskill.parts import BLUE, CUBE_HALF_SIZE_M, GOAL_Z_M, RED, box, cube, target
from envs.tasks.skills.from_above import grasp, slide
from envs.tasks.skills.joints import along_joint
from envs.tasks.tabletop import (
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    distance,
    ee_pos,
    flat_distance,
    hand_pitch,
    hand_yaw,
    is_held,
    nearness,
    point_on,
)

PEG_HALF_LENGTH_M, PEG_HALF_WIDTH_M = 0.12, 0.025
GRASP_REACH_M = 0.03
STEEP_RAD = 1.1
"""Angle of the peg against the level up to which the expert turns it about its edge; then it looks again."""

LIGHT_GRIP_M = 0.002
"""How much closer than the peg's sides the expert's fingers would be: it turns in them by its weight."""

TIP_RAD = 0.2
"""Least tip of the expert's hand, which keeps the head of the peg off its palm."""


def peg(half_length_m: float, half_width_m: float, head: Rgba, tail: Rgba) -> ObjectCfg:
    """Returns a peg along x, whose head points to positive x."""
    half = (half_length_m / 2, half_width_m, half_width_m)
    geoms = (box(half, head, (half[0], 0.0, 0.0)), box(half, tail, (-half[0], 0.0, 0.0)))
    return ObjectCfg(name="peg", geoms=geoms, pos=(0.0, 0.0, half_width_m))


def on_peg(item: EntityState, along_m: float) -> Tensor:
    """Returns the point of a peg so far from its middle towards its head, (N, 3), m."""
    return point_on(item, (along_m, 0.0, 0.0))


@dataclass(frozen=True, kw_only=True)
class LiftPegUpright(ArmAtTable):
    """Take a peg that lies on the table and stand it on its end.

    Attributes:
        peg_half_length_m: Half the length of the peg.
        peg_half_width_m: Half the side of its section.
        spawn_half_size_m: Half the side of the square of its middle's start.
        tilt_tolerance_rad: Largest angle between the upright peg and the vertical.
        height_tolerance_m: Largest distance of its middle from the height at which it stands.
        grip_m: Distance from the peg's middle at which it is gripped, towards its head.
    """

    name: ClassVar[str] = "LiftPegUpright"
    instructions: ClassVar[tuple[str, ...]] = (
        "stand the peg upright on the table",
        "lift the peg and put it down on its end",
        "pick up the lying red and blue peg and set it upright",
    )
    max_episode_steps: ClassVar[int] = 150
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, fovy_deg=30.0)

    peg_half_length_m: float = PEG_HALF_LENGTH_M
    peg_half_width_m: float = PEG_HALF_WIDTH_M
    spawn_half_size_m: float = 0.1
    tilt_tolerance_rad: float = 0.08
    height_tolerance_m: float = 0.005
    grip_m: float = 0.09

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (peg(self.peg_half_length_m, self.peg_half_width_m, RED, BLUE),)

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        place = rng.uniform(-self.spawn_half_size_m, self.spawn_half_size_m, 2)
        return {"peg": Start((*place, self.peg_half_width_m))}

    @override
    def success(self, state: State) -> Tensor:
        off = abs(state.objects["peg"].pos[:, 2] - self.peg_half_length_m)
        upright = self._rise(state) > np.cos(self.tilt_tolerance_rad)
        return upright & (off < self.height_tolerance_m)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns 0.2 each for reach and grasp, 0.35 for the turn, 0.2 for the height of an upright peg."""
        item, robot = state.objects["peg"], self.arm(state)
        reach = distance(ee_pos(robot), on_peg(item, self.grip_m))
        held = is_held(
            robot, on_peg(item, self.grip_m), 2 * GRASP_REACH_M, 2 * self.peg_half_width_m, cfg=self.robot
        )
        turned = self._rise(state)
        off = abs(item.pos[:, 2] - self.peg_half_length_m)
        return 0.2 * (nearness(reach) + held + turned**8 * nearness(off, 10.0)) + 0.35 * turned

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the peg's pose, the end effector and its way to where the peg is gripped, (N, 13)."""
        item, hand = state.objects["peg"], ee_pos(self.arm(state))
        return concatenate((item.pos, item.rot, hand, on_peg(item, self.grip_m) - hand))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        item, hold, grip = state.objects["peg"], GRASP_OPEN_M, self.peg_half_width_m - LIGHT_GRIP_M
        axis = rotate(item.rot, constant((1.0, 0.0, 0.0), item.pos))[0].numpy()
        held = bool(
            is_held(
                self.arm(state), item.pos, self.peg_half_length_m, 2 * self.peg_half_width_m, cfg=self.robot
            )[0]
        )
        if held and abs(axis[2]) > 0.6:
            return self._finish(state, np.sign(axis[2]) * axis, grip)
        turn = heading(item)
        forward = np.array([np.cos(turn), np.sin(turn), 0.0])
        if forward[0] < 0.0:  # grip the end that points away from the robot
            turn, forward = float((turn + 2 * np.pi) % (2 * np.pi) - np.pi), -forward
        reach = self.grip_m + rng.uniform(-0.005, 0.005)
        place = point(item) + reach * forward
        place[2] = self.peg_half_width_m
        noise = first_miss(rng, (0.06, 0.09))
        # The peg turns about the lower edge of its tail, and in the fingers where the hand tips less.
        long, wide = self.peg_half_length_m + reach, self.peg_half_width_m
        edge = point(item) - self.peg_half_length_m * forward
        edge[2] = 0.0
        pace, tip = rng.uniform(0.9, 1.2), min(tip_to_reach(place, self.robot), -TIP_RAD)

        def at(angle: float, seconds: float, gripper: float = grip, hold_s: float = 0.0) -> Waypoint:
            along, up = (
                np.cos(angle) * long - np.sin(angle) * wide,
                np.sin(angle) * long + np.cos(angle) * wide,
            )
            pos = edge + along * forward + np.array([0.0, 0.0, up])
            return way(pos, turn, gripper, pace * seconds, hold_s, tip)

        over = way(place + noise, turn, hold, 0.8, pitch=tip)
        return [
            *self.rise(state, 0.1),
            *grasp(over, place, rng, closed_m=grip, down_s=0.4),
            *along_joint(lambda angle: at(angle, 0.35), 0.0, STEEP_RAD, 5),
        ]

    def _finish(self, state: State, axis: np.ndarray, grip: float) -> list[Waypoint]:
        """Returns the way to tip a peg that leans in the fingers along ``axis`` (3,) up to the vertical."""
        robot = self.arm(state)
        hand, middle = ee_pos(robot)[0].numpy(), point(state.objects["peg"])
        reach = float((hand - middle) @ axis)
        lean = np.array([axis[0], axis[1], 0.0])
        turn, tip = hand_yaw(robot), hand_pitch(robot)
        end = hand - 1.2 * (self.peg_half_length_m + reach) * lean
        end[2] = self.peg_half_length_m + reach - 0.008  # the tail drags on the table, and stays behind
        return [way(end, turn, grip, 0.3 + float(np.linalg.norm(lean)), 0.1, tip)]

    def _rise(self, state: State) -> Array:
        """Returns the sine of the angle between the peg and the level, (N,)."""
        axis = rotate(state.objects["peg"].rot, constant((1.0, 0.0, 0.0), state.objects["peg"].pos))
        return abs(axis[:, 2])


@dataclass(frozen=True, kw_only=True)
class PokeCube(ArmAtTable):
    """Take a peg and push a cube with its head onto the target, lined up with the cube.

    Attributes:
        peg_half_length_m: Half the length of the peg.
        peg_half_width_m: Half the side of its section.
        cube_half_size_m: Half the side of the cube.
        spawn_half_size_m: Half the side of the square of the peg's start, and of the cube's along y.
        cube_gap_m: Distance of the cube's centre from the peg's head along x.
        cube_yaw_rad: Largest turn of the cube.
        goal_radius_m: Radius of the target; the cube's centre has to be within.
        goal_gap_m: Distance of the target's edge from the cube's start.
        align_tolerance_rad: Largest angle between peg and cube.
        touch_tolerance_m: Largest gap between the peg's head and the cube.
        lift_tolerance_m: Largest height of the peg above the table.
    """

    name: ClassVar[str] = "PokeCube"
    instructions: ClassVar[tuple[str, ...]] = (
        "poke the red cube onto the target with the peg",
        "push the red cube into the goal region with the blue stick",
        "pick up the peg and use its head to slide the cube onto the circle",
    )
    max_episode_steps: ClassVar[int] = 150
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, look_at=(0.1, 0.0, 0.08), fovy_deg=38.0)

    peg_half_length_m: float = PEG_HALF_LENGTH_M
    peg_half_width_m: float = PEG_HALF_WIDTH_M
    cube_half_size_m: float = CUBE_HALF_SIZE_M
    spawn_half_size_m: float = 0.1
    cube_gap_m: float = 0.1
    cube_yaw_rad: float = np.pi / 6
    goal_radius_m: float = 0.05
    goal_gap_m: float = 0.05
    align_tolerance_rad: float = 0.05
    touch_tolerance_m: float = 0.005
    lift_tolerance_m: float = 0.005

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (
            peg(self.peg_half_length_m, self.peg_half_width_m, BLUE, BLUE),
            cube("cube", self.cube_half_size_m, RED),
            target("goal", self.goal_radius_m),
        )

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        x, y, cube_y = rng.uniform(-self.spawn_half_size_m, self.spawn_half_size_m, 3)
        cube_x = x + self.peg_half_length_m + self.cube_gap_m
        goal_x = cube_x + self.goal_gap_m + self.goal_radius_m
        yaw = rng.uniform(-self.cube_yaw_rad, self.cube_yaw_rad)
        return {
            "peg": Start((x, y, self.peg_half_width_m)),
            "cube": Start((cube_x, cube_y, self.cube_half_size_m), yaw),
            "goal": Start((goal_x, cube_y, GOAL_Z_M)),
        }

    @override
    def success(self, state: State) -> Tensor:
        item = state.objects["peg"]
        low = abs(item.pos[:, 2] - self.peg_half_width_m) < self.lift_tolerance_m
        placed = flat_distance(state.objects["cube"].pos, state.objects["goal"].pos) < self.goal_radius_m
        return placed & self._fits(state) & low

    @override
    def reward(self, state: State) -> Tensor:
        """Returns ManiSkill's: reach the peg; hold it, close to and in line with the cube; push."""
        item, robot, cube_ = state.objects["peg"], self.arm(state), state.objects["cube"]
        reach = distance(ee_pos(robot), item.pos)
        held = is_held(robot, item.pos, GRASP_REACH_M, 2 * self.peg_half_width_m, cfg=self.robot)
        close, lined = nearness(self._gap(state)), nearness(self._angle(state))
        place = nearness(distance(cube_.pos, state.objects["goal"].pos))
        carried = 4.0 + close + lined
        return where(held, where(self._fits(state), 7.0 + place, carried), 2.0 * nearness(reach)) / 9.0

    @override
    def observe(self, state: State) -> Tensor:
        """Returns poses of peg and cube, target, end effector, and ways between them, (N, 32)."""
        item, cube_, goal = state.objects["peg"], state.objects["cube"], state.objects["goal"].pos
        hand, head = ee_pos(self.arm(state)), on_peg(state.objects["peg"], self.peg_half_length_m)
        ways = (item.pos - hand, cube_.pos - item.pos, goal - cube_.pos, cube_.pos - head)
        return concatenate((item.pos, item.rot, cube_.pos, cube_.rot, goal, hand, *ways))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        item, cube_, grip = state.objects["peg"], state.objects["cube"], GRASP_CLOSED_M
        start, turn, goal = point(item), heading(item), point(state.objects["goal"])
        line = heading(cube_)
        line -= np.pi / 2 * round(line / (np.pi / 2))
        ahead = np.array([np.cos(line), np.sin(line), 0.0])
        touch = self.peg_half_length_m + self.cube_half_size_m
        slack = rng.uniform(0.025, 0.04)
        low = np.array([*point(cube_)[:2], self.peg_half_width_m])
        behind = low - (touch + slack) * ahead
        contact = low - touch * ahead
        # Half way between where the cube faces and where the target is: its face does not slip off the peg's.
        far, half = goal[0] - low[0] - 0.4 * self.goal_radius_m, 0.5 * line
        push = far * np.array([np.cos(half), np.sin(half), 0.0])
        end = above(contact, 0.001) + push
        tip = tip_to_reach(end, self.robot)
        noise = first_miss(rng, (0.06, 0.09))
        near = above(behind, 0.04) + first_miss(rng, often_m=0.008, seldom_m=0.02)
        over = way(near, line, grip, travel_s(start, near, 0.5), 0.0, tip)
        places = (above(behind, 0.001), above(contact, 0.001), end)
        push_s = 0.3 + 5.0 * float(np.linalg.norm(push))
        return [
            *self.rise(state, 0.1),
            *grasp(way(start + noise, turn, GRASP_OPEN_M, 0.8, pitch=tip), start, rng, down_s=0.4),
            way(above(start, 0.04), turn, grip, 0.4, 0.0, tip),
            over,
            *slide(over, places, (0.5, 0.3, push_s), settle_s=0.1, hold_s=0.2),
        ]

    def _gap(self, state: State) -> Array:
        head = on_peg(state.objects["peg"], self.peg_half_length_m)
        return flat_distance(head, state.objects["cube"].pos)

    def _angle(self, state: State) -> Array:
        """Returns the angle between peg and cube, (N,), rad, at most a quarter turn."""
        return abs(yaw_of(state.objects["peg"].rot) - yaw_of(state.objects["cube"].rot))

    def _fits(self, state: State) -> Array:
        close = self._gap(state) <= self.cube_half_size_m + self.touch_tolerance_m
        return close & (self._angle(state) < self.align_tolerance_rad)

"""Lift and Stack, after robosuite 1.5.1 (``environments/manipulation/lift.py`` and ``stack.py``, MIT).

robosuite draws the side of Lift's cube once for each environment, 40 to 44 mm; here it is an option. The
rewards are robosuite's shaped ones; it reads a grasp from contacts, here a cube is grasped when it keeps
closing fingers apart.
"""

from dataclasses import dataclass
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, largest, where
from envs.kinematics.waypoints import Waypoint, correction_s, first_miss, grasp_yaw, miss
from envs.scenario import GeomCfg, ObjectCfg, Rgba
from envs.state import EntityState, State
from envs.tasks.arm_at_table import Start, above, heading, point, travel_s
from envs.tasks.robosuite.scene import RobosuiteTask, down, pedestal
from envs.tasks.skills.from_above import grasp, set_down
from envs.tasks.tabletop import (
    DENSITY_KG_M3,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    distance,
    ee_pos,
    flat_distance,
    hand_yaw,
    is_held,
    nearness,
)

LIFTED_M = 0.04
"""Height of a cube's centre above the table at which it counts as lifted."""

GRASP_REACH_M = 0.03
TOUCH_M = 2e-3
"""Gap of two cubes that touch, where only their places are known."""

DETOUR_M = 0.03
_RED: Rgba = (0.6, 0.1, 0.08, 1.0)
_GREEN: Rgba = (0.15, 0.5, 0.15, 1.0)


def _cube(name: str, half_m: float, rgba: Rgba, feels: tuple[str, ...] = ()) -> ObjectCfg:
    mass = 8 * half_m**3 * DENSITY_KG_M3  # MuJoCo's default density
    geom = GeomCfg(shape="box", size=(half_m,) * 3, rgba=rgba, mass_kg=mass)
    return ObjectCfg(name=name, geoms=(geom,), pos=(0.0, 0.0, half_m), feels=feels)


@dataclass(frozen=True, kw_only=True)
class Lift(RobosuiteTask):
    """Grasp a cube and lift it off the table.

    Attributes:
        cube_half_size_m: Half the side of the cube.
        spawn_half_size_m: Half the side of the square of its start.
        height_m: Height of its centre above the table that is a success.
    """

    name: ClassVar[str] = "Lift"
    instructions: ClassVar[tuple[str, ...]] = (
        "lift the red cube",
        "pick up the cube from the table",
        "grasp the cube and raise it",
    )
    max_episode_steps: ClassVar[int] = 150

    cube_half_size_m: float = 0.021
    spawn_half_size_m: float = 0.03
    height_m: float = LIFTED_M

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (_cube("cube", self.cube_half_size_m, _RED), pedestal(self.robot))

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        place = rng.uniform(-self.spawn_half_size_m, self.spawn_half_size_m, 2)
        return {"cube": Start((*place, self.cube_half_size_m), rng.uniform(-np.pi, np.pi))}

    @override
    def success(self, state: State) -> Tensor:
        return state.objects["cube"].pos[:, 2] > self.height_m

    @override
    def reward(self, state: State) -> Tensor:
        """Returns robosuite's: nearness of the hand, and 0.25 for a grasp; over 2.25."""
        cube = state.objects["cube"]
        held = is_held(self.arm(state), cube.pos, GRASP_REACH_M, 2 * self.cube_half_size_m, cfg=self.robot)
        return (nearness(distance(ee_pos(self.arm(state)), cube.pos), 10.0) + 0.25 * held) / 2.25

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the cube's pose, the end effector and the way between them, (N, 13)."""
        cube, hand = state.objects["cube"], ee_pos(self.arm(state))
        return concatenate((cube.pos, cube.rot, hand, cube.pos - hand))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        cube = state.objects["cube"]
        start, turn = point(cube), grasp_yaw(heading(cube))
        # The approach first misses: the next motion demonstrates the correction.
        noise = first_miss(rng, (0.06, 0.09), often_m=0.015, seldom_m=0.05)
        turn_s = 0.7 + 0.3 * abs(turn - hand_yaw(self.arm(state)))
        return [
            *self.rise(state, 0.08),
            *grasp(
                down(start + noise, turn, GRASP_OPEN_M, turn_s), start, rng, 0.05, down_s=0.4, close_s=0.25
            ),
            down(above(start, 0.1), turn, GRASP_CLOSED_M, 0.7),
        ]


@dataclass(frozen=True, kw_only=True)
class Stack(RobosuiteTask):
    """Put the small red cube on the larger green cube and let go of it.

    Attributes:
        cube_a_half_size_m: Half the side of the red cube.
        cube_b_half_size_m: Half the side of the green cube.
        spawn_half_size_m: Half the side of the square of both starts.
        height_m: Height of the red cube's centre above the table that a success takes.
    """

    name: ClassVar[str] = "Stack"
    instructions: ClassVar[tuple[str, ...]] = (
        "stack the red cube on the green cube",
        "put the small cube on top of the large one",
        "pick up the red cube, set it on the green cube and let go",
    )
    max_episode_steps: ClassVar[int] = 200

    cube_a_half_size_m: float = 0.02
    cube_b_half_size_m: float = 0.025
    spawn_half_size_m: float = 0.08
    height_m: float = LIFTED_M

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (
            _cube("cube_a", self.cube_a_half_size_m, _RED, feels=("cube_b",)),
            _cube("cube_b", self.cube_b_half_size_m, _GREEN),
            pedestal(self.robot),
        )

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        apart = np.sqrt(2.0) * (self.cube_a_half_size_m + self.cube_b_half_size_m)
        while True:
            a, b = rng.uniform(-self.spawn_half_size_m, self.spawn_half_size_m, (2, 2))
            if np.linalg.norm(a - b) > apart:
                break
        yaw_a, yaw_b = rng.uniform(-np.pi, np.pi, 2)
        return {
            "cube_a": Start((*a, self.cube_a_half_size_m), yaw_a),
            "cube_b": Start((*b, self.cube_b_half_size_m), yaw_b),
        }

    @override
    def success(self, state: State) -> Tensor:
        a = state.objects["cube_a"]
        return (a.pos[:, 2] > self.height_m) & self._touches(state) & ~self._held(state, a)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns robosuite's: the largest of reach and grasp, and of lift and align; over 2."""
        a, b = state.objects["cube_a"], state.objects["cube_b"]
        reach = 0.25 * nearness(distance(ee_pos(self.arm(state)), a.pos), 10.0)
        grasp = reach + 0.25 * self._held(state, a)
        lift = 1.0 + 0.5 * nearness(flat_distance(a.pos, b.pos), 1.0)
        return where(a.pos[:, 2] > self.height_m, lift, grasp) / 2.0

    @override
    def observe(self, state: State) -> Tensor:
        """Returns both cubes' poses, the end effector, and the ways between the three, (N, 26)."""
        a, b = state.objects["cube_a"], state.objects["cube_b"]
        hand = ee_pos(self.arm(state))
        return concatenate((a.pos, a.rot, b.pos, b.rot, hand, a.pos - hand, b.pos - hand, b.pos - a.pos))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        a, hold, grip = state.objects["cube_a"], GRASP_OPEN_M, GRASP_CLOSED_M
        start, base = point(a), point(state.objects["cube_b"])
        top = above(base, self.cube_a_half_size_m + self.cube_b_half_size_m + 0.001)
        turn = grasp_yaw(heading(a))
        other = turn - np.copysign(np.pi / 2, turn)
        # At turn 0 fingers close along y: they stay off the other cube.
        aside = [abs((base - start)[:2] @ (-np.sin(t), np.cos(t))) for t in (turn, other)]
        turn = float(other if aside[0] > aside[1] and np.linalg.norm((base - start)[:2]) < 0.13 else turn)
        noise = first_miss(rng, (0.07, 0.1), seldom_m=DETOUR_M)
        off = rng.normal(0.0, miss(rng, often_m=0.01, seldom_m=DETOUR_M), 2)
        over = above(top, 0.06)
        near = over + np.array([*off, 0.0])
        lift = np.array([*start[:2], near[2]])
        turn_s = 0.7 + 0.3 * abs(turn - hand_yaw(self.arm(state)))
        return [
            *self.rise(state, 0.1),
            *grasp(down(start + noise, turn, hold, turn_s), start, rng, DETOUR_M, close_s=0.25),
            down(lift, turn, grip, 0.5),
            down(near, turn, grip, travel_s(lift, near)),
            *set_down(down(over, turn, grip, correction_s(off) + 0.1), top),
        ]

    def _touches(self, state: State) -> Array:
        """Returns whether the cubes touch, (N,): by their places where a simulator does not say so."""
        a, b = state.objects["cube_a"], state.objects["cube_b"]
        if a.touched is not None:
            return a.touched[:, 0] > 0.5
        sides, off = self.cube_a_half_size_m + self.cube_b_half_size_m, abs(a.pos - b.pos)
        return (off[:, 2] < sides + TOUCH_M) & (largest(off[:, :2]) < sides)

    def _held(self, state: State, item: EntityState) -> Array:
        return is_held(self.arm(state), item.pos, GRASP_REACH_M, 2 * self.cube_a_half_size_m, cfg=self.robot)

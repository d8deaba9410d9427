"""StackPyramid, after ManiSkill 3 (``tabletop/stack_pyramid.py``).

ManiSkill has no dense reward for it; ours has the stages of its StackCube for each cube. Its grasp test reads
contact forces, which a state does not have; here a cube is grasped when it keeps closing fingers apart.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, at_least, concatenate, constant, norm, where
from envs.kinematics.waypoints import Waypoint, approach, correction_s, first_miss, grasp_yaw, miss
from envs.scenario import CameraCfg, ObjectCfg
from envs.state import EntityState, State
from envs.tasks.arm_at_table import ArmAtTable, Start, above, heading, point, travel_s, way
from envs.tasks.maniskill.parts import BLUE, CUBE_HALF_SIZE_M, GREEN, RED, cube, is_still
from envs.tasks.skills.from_above import grasp, set_down
from envs.tasks.tabletop import (
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    distance,
    ee_pos,
    finger_gap,
    flat_distance,
    hand_yaw,
    is_held,
    nearness,
)

GRASP_REACH_M = 0.03
OPEN_M = 0.032
"""Opening of the expert's fingers round a cube, which keeps them off its neighbours."""

GAP_M = 0.002
"""Gap that the expert leaves between the two lower cubes."""

DETOUR_M = 0.02
CLEAR_M = 0.085
"""Least distance of the third cube from where the expert puts the first one."""


@dataclass(frozen=True, kw_only=True)
class StackPyramid(ArmAtTable):
    """Put the red cube beside the green one and the blue cube on both.

    Attributes:
        cube_half_size_m: Half the side of each cube.
        spawn_offset_m: All cubes are moved together by up to this along x and y.
        spawn_half_size_m: Half extents of the box round that offset in which each cube starts.
        clearance_m: Added to the circle round each cube's base; circles do not overlap at the start.
        tolerance_m: Largest excess of the level distance of two cubes over the diagonal of one's face.
    """

    name: ClassVar[str] = "StackPyramid"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the red cube next to the green cube and stack the blue cube on both of them",
        "build a pyramid: red and green cube side by side, the blue one on top",
        "place the red cube beside the green one, then put the blue cube on top of them",
    )
    max_episode_steps: ClassVar[int] = 350
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, fovy_deg=30.0)

    cube_half_size_m: float = CUBE_HALF_SIZE_M
    spawn_offset_m: float = 0.1
    spawn_half_size_m: tuple[float, float] = (0.1, 0.2)
    clearance_m: float = 0.001
    tolerance_m: float = 0.005

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        colors = {"cube_a": RED, "cube_b": GREEN, "cube_c": BLUE}
        return tuple(cube(name, self.cube_half_size_m, rgba) for name, rgba in colors.items())

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        offset = rng.uniform(-self.spawn_offset_m, self.spawn_offset_m, 2)
        apart = 2 * (np.sqrt(2) * self.cube_half_size_m + self.clearance_m)
        places: list[np.ndarray] = []
        while len(places) < 3:
            place = rng.uniform(-1.0, 1.0, 2) * self.spawn_half_size_m
            if all(np.linalg.norm(place - other) > apart for other in places):
                places.append(place)
        return {
            name: Start((*(offset + place), self.cube_half_size_m), rng.uniform(-np.pi, np.pi))
            for name, place in zip(("cube_a", "cube_b", "cube_c"), places, strict=True)
        }

    @override
    def success(self, state: State) -> Tensor:
        a, c = state.objects["cube_a"], state.objects["cube_c"]
        let_go = ~self._held(state, a) & ~self._held(state, c)
        return self._beside(state) & self._on_both(state) & is_still(a) & is_still(c) & let_go

    @override
    def reward(self, state: State) -> Tensor:
        """Returns stages for the red cube, then for the blue one: reach, grasp, place; then let go."""
        a, c = state.objects["cube_a"], state.objects["cube_c"]
        hand, b = ee_pos(self.arm(state)), state.objects["cube_b"]
        high = at_least(a.pos[:, 2] - self.cube_half_size_m, 0.0)
        gap = at_least(flat_distance(a.pos, b.pos) - 2 * self.cube_half_size_m - 2 * GAP_M, 0.0) + high
        held_a, held_c = self._held(state, a), self._held(state, c)
        first = where(held_a, 1.0 + nearness(gap), nearness(distance(hand, a.pos)))
        placed = 2.0 + nearness(distance(c.pos, self._top(state)))
        second = 2.0 + where(held_c, placed, nearness(distance(hand, c.pos)))
        rest = nearness(10.0 * norm(c.lin_vel) + norm(c.ang_vel), 1.0)
        opened = where(held_c, finger_gap(self.arm(state), self.robot) / 0.08, 1.0)
        done = 5.0 + 0.5 * (opened + rest)
        ready = self._beside(state) & ~held_a
        return where(ready, where(self._on_both(state), done, second), first) / 7.0

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the cubes' poses, end effector, ways from it and between the cubes, (N, 42)."""
        a, b, c = (state.objects[name] for name in ("cube_a", "cube_b", "cube_c"))
        hand = ee_pos(self.arm(state))
        ways = (a.pos - hand, b.pos - hand, c.pos - hand, b.pos - a.pos, c.pos - b.pos, c.pos - a.pos)
        return concatenate((a.pos, a.rot, b.pos, b.rot, c.pos, c.rot, hand, *ways))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        a, b, c = (point(state.objects[name]) for name in ("cube_a", "cube_b", "cube_c"))
        line = grasp_yaw(heading(state.objects["cube_b"]))
        if bool((self._beside(state) & self._on_both(state))[0]):
            return self.rise(state, 0.2)
        side = 2 * self.cube_half_size_m
        together = bool(self._beside(state)[0]) and np.linalg.norm((a - b)[:2]) < side + 0.012
        if together:
            top = 0.5 * (a + b) + np.array([0.0, 0.0, side])
            return self._move(state, "cube_c", (a, b), top, line, rng)
        turns = (line, line - np.copysign(np.pi / 2, line))
        options = [
            (turn, b + sign * (side + GAP_M) * np.array([np.cos(turn), np.sin(turn), 0.0]))
            for turn in turns
            for sign in (-1.0, 1.0)
        ]
        free = [option for option in options if np.linalg.norm((option[1] - c)[:2]) > CLEAR_M]
        turn, spot = min(
            free or options, key=lambda option: abs(option[0]) + 3 * np.linalg.norm(option[1] - a)
        )
        return self._move(state, "cube_a", (b, c), spot, turn, rng)

    def _move(
        self,
        state: State,
        name: str,
        others: tuple[np.ndarray, np.ndarray],
        spot: np.ndarray,
        line: float,
        rng: np.random.Generator,
    ) -> list[Waypoint]:
        """Returns the way to grasp a cube, to set it down at a place and to let go of it.

        Args:
            state: A state of one row.
            name: The cube.
            others: Positions of the two others, (3,), m.
            spot: Where its centre goes, (3,), m.
            line: Turn of the hand there.
            rng: Varies the way.
        """
        item = state.objects[name]
        start, yaw = point(item), grasp_yaw(heading(item))
        yaw = max((yaw, yaw - np.copysign(np.pi / 2, yaw)), key=lambda turn: _clearance(turn, start, others))
        noise = first_miss(rng, (0.07, 0.1), seldom_m=DETOUR_M)
        aside = rng.normal(0.0, miss(rng, often_m=0.008, seldom_m=DETOUR_M), 2)
        over = above(spot, 0.07)
        near = over + np.array([*aside, 0.0])
        lift = np.array([*start[:2], max(near[2], 0.1)])
        hold, grip = OPEN_M, GRASP_CLOSED_M
        turn_s = 0.6 + 0.25 * abs(yaw - hand_yaw(self.arm(state)))
        return [
            *self.rise(state, 0.1),
            *approach(way(start + noise, yaw, hold, turn_s), rng, DETOUR_M),
            *grasp(way(above(start, 0.05), yaw, hold, 0.3), start, None, down_s=0.4, close_s=0.25),
            way(lift, yaw, grip, 0.5),
            way(near, line, grip, travel_s(lift, near) + 0.2 * abs(line - yaw)),
            *set_down(
                way(over, line, grip, correction_s(aside) + 0.1, hold_s=0.1),
                above(spot, 0.001),
                opening_m=hold,
                down_s=0.6,
                settle_s=0.2,
                rise_m=0.099,
                hold_s=0.1,
            ),
        ]

    def _near(self, a: EntityState, b: EntityState) -> Array:
        """Returns whether two cubes are near each other in the plane, (N,)."""
        most = 2 * np.sqrt(2) * self.cube_half_size_m + self.tolerance_m
        return flat_distance(a.pos, b.pos) <= most

    def _beside(self, state: State) -> Array:
        return self._near(state.objects["cube_a"], state.objects["cube_b"])

    def _on_both(self, state: State) -> Array:
        a, b, c = (state.objects[name] for name in ("cube_a", "cube_b", "cube_c"))
        high = (abs(c.pos - a.pos)[:, 2] > self.cube_half_size_m) & (
            abs(c.pos - b.pos)[:, 2] > self.cube_half_size_m
        )
        return high & self._near(c, a) & self._near(c, b)

    def _top(self, state: State) -> Array:
        """Returns the place of the blue cube, (N, 3)."""
        middle = 0.5 * (state.objects["cube_a"].pos + state.objects["cube_b"].pos)
        return middle + constant((0.0, 0.0, 2 * self.cube_half_size_m), middle)

    def _held(self, state: State, item: EntityState) -> Array:
        return is_held(self.arm(state), item.pos, GRASP_REACH_M, 2 * self.cube_half_size_m, cfg=self.robot)


def _clearance(turn: float, start: np.ndarray, others: tuple[np.ndarray, np.ndarray]) -> float:
    """Returns how far the other cubes are from the fingers that open along y when the turn is 0, m."""
    fingers = [start + sign * 0.05 * np.array([-np.sin(turn), np.cos(turn), 0.0]) for sign in (-1, 1)]
    return min(min(float(np.linalg.norm((f - o)[:2])) for f in fingers for o in others), 0.08)

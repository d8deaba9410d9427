"""PlaceSphere, after ManiSkill 3 (``tabletop/place_sphere.py``).

The reward is ManiSkill's without its term for a still robot. Its grasp test reads contact forces, which a
state does not have; here the sphere is grasped when it keeps closing fingers apart.
"""

from dataclasses import dataclass
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, constant, norm, where
from envs.kinematics.waypoints import Waypoint, correction_s, first_miss, miss
from envs.scenario import GeomCfg, ObjectCfg, Rgba
from envs.state import State
from envs.tasks.arm_at_table import ArmAtTable, Start, above, point, travel_s, way
from envs.tasks.maniskill.parts import BLUE, STATIC_SPEED_M_S, STATIC_SPEED_RAD_S
from envs.tasks.skills.from_above import grasp, set_down
from envs.tasks.tabletop import (
    DENSITY_KG_M3,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    distance,
    ee_pos,
    finger_gap,
    flat_distance,
    is_held,
    nearness,
)

GRASP_REACH_M = 0.025
_WOOD: Rgba = (0.75, 0.6, 0.4, 1.0)


@dataclass(frozen=True, kw_only=True)
class PlaceSphere(ArmAtTable):
    """Put a ball into a shallow bin and let go of it.

    Attributes:
        radius_m: Radius of the ball.
        inner_half_size_m: Half the inner side of the bin.
        wall_half_m: Half the thickness of the bin's floor and walls, which are four times as high above it.
        spawn_x_m: Range of the ball's start along x.
        bin_x_m: Range of the bin along x.
        spawn_y_m: Range of both along y.
        tolerance_m: Largest distance of the ball from its place, level and upright each.
    """

    name: ClassVar[str] = "PlaceSphere"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the blue ball into the bin",
        "pick up the ball and place it in the shallow box",
        "place the sphere in the bin and let go of it",
    )
    max_episode_steps: ClassVar[int] = 150

    radius_m: float = 0.02
    inner_half_size_m: float = 0.02
    wall_half_m: float = 0.0025
    spawn_x_m: tuple[float, float] = (-0.1, -0.05)
    bin_x_m: tuple[float, float] = (0.0, 0.1)
    spawn_y_m: tuple[float, float] = (-0.1, 0.1)
    tolerance_m: float = 0.005

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        mass = 4 / 3 * np.pi * self.radius_m**3 * DENSITY_KG_M3
        ball = GeomCfg(shape="sphere", size=(self.radius_m,), rgba=BLUE, mass_kg=mass)
        return (
            ObjectCfg(name="sphere", geoms=(ball,), pos=(0.0, 0.0, self.radius_m)),
            ObjectCfg(name="bin", geoms=self._bin, pos=(0.05, 0.0, self.wall_half_m), kind="fixed"),
        )

    @property
    def _bin(self) -> tuple[GeomCfg, ...]:
        thin = self.wall_half_m
        wide = self.inner_half_size_m + 2 * thin
        off, up = wide - thin, 3 * thin
        walls = [
            GeomCfg(shape="box", size=size, pos=pos, rgba=_WOOD)
            for sign in (-1, 1)
            for size, pos in (
                ((thin, wide, 2 * thin), (sign * off, 0.0, up)),
                ((wide, thin, 2 * thin), (0.0, sign * off, up)),
            )
        ]
        return (GeomCfg(shape="box", size=(wide, wide, thin), rgba=_WOOD), *walls)

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        return {
            "sphere": Start((rng.uniform(*self.spawn_x_m), rng.uniform(*self.spawn_y_m), self.radius_m)),
            "bin": Start((rng.uniform(*self.bin_x_m), rng.uniform(*self.spawn_y_m), self.wall_half_m)),
        }

    @override
    def success(self, state: State) -> Tensor:
        ball = state.objects["sphere"]
        still = (norm(ball.lin_vel) <= STATIC_SPEED_M_S) & (norm(ball.ang_vel) <= STATIC_SPEED_RAD_S)
        apart = finger_gap(self.arm(state), self.robot) >= 0.0  # false where it is not finite
        return self._in_bin(state) & still & ~self._held(state) & apart

    @override
    def reward(self, state: State) -> Tensor:
        """Returns ManiSkill's: reach, hold over the bin, let go and be still; 1 on success."""
        ball, robot = state.objects["sphere"], self.arm(state)
        held = self._held(state)
        reach = 2.0 * nearness(distance(ee_pos(robot), ball.pos))
        place = 4.0 + nearness(distance(self._place(state), ball.pos))
        opened = where(held, finger_gap(robot, self.robot) / (2 * GRASP_OPEN_M), 1.0)
        rest = 6.0 + opened + nearness(10.0 * norm(ball.lin_vel) + norm(ball.ang_vel), 1.0)
        return where(self._in_bin(state), rest, where(held, place, reach)) / 9.0

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the ball's position, the bin's, the end effector, and ways between them, (N, 15)."""
        ball, goal = state.objects["sphere"].pos, state.objects["bin"].pos
        hand = ee_pos(self.arm(state))
        return concatenate((ball, goal, hand, ball - hand, goal - ball))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        ball, hold, grip = point(state.objects["sphere"]), GRASP_OPEN_M, GRASP_CLOSED_M
        if bool(self._in_bin(state)[0]):
            return self.rise(state, 0.12)
        spot = above(point(state.objects["bin"]), self.wall_half_m + self.radius_m + 0.006)
        noise = first_miss(rng, (0.06, 0.09), often_m=0.015, seldom_m=0.05)
        aside = rng.normal(0.0, miss(rng, often_m=0.01, seldom_m=0.03), 2)
        over = above(spot, 0.05)
        near = over + np.array([*aside, 0.0])
        return [
            *self.rise(state, 0.08),
            *grasp(way(ball + noise, 0.0, hold, 0.6), ball, rng, 0.05, down_s=0.4),
            way(above(ball, 0.06), 0.0, grip, 0.4),
            way(near, 0.0, grip, travel_s(ball, near)),
            *set_down(
                way(over, 0.0, grip, correction_s(aside) + 0.1),
                spot,
                settle_s=0.2,
                open_s=0.2,
                wait_s=0.1,
                hold_s=0.3,
            ),
        ]

    def _place(self, state: State) -> Array:
        goal = state.objects["bin"].pos
        return goal + constant((0.0, 0.0, self.wall_half_m + self.radius_m), goal)

    def _in_bin(self, state: State) -> Array:
        ball, place = state.objects["sphere"].pos, self._place(state)
        up = abs(ball[:, 2] - place[:, 2]) <= self.tolerance_m
        return (flat_distance(ball, place) <= self.tolerance_m) & up

    def _held(self, state: State) -> Array:
        ball = state.objects["sphere"].pos
        return is_held(self.arm(state), ball, GRASP_REACH_M, 2 * self.radius_m, cfg=self.robot)

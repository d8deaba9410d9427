"""RollBall, after ManiSkill 3 (``tabletop/roll_ball.py``).

ManiSkill's reward remembers whether the hand has been behind the ball; a state has no memory, so here it
counts the ball's way while the hand is there or the ball rolls.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import concatenate, norm, tanh, where
from envs.kinematics.waypoints import Waypoint, approach, miss
from envs.rotations import from_yaw
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, RobotCfg, TableCfg
from envs.state import State
from envs.tasks.arm_at_table import ArmAtTable, Start, point, way
from envs.tasks.maniskill.parts import BLUE, DENSITY_KG_M3, GOAL_Z_M, flat_distance, target
from envs.tasks.maniskill.push_and_pull import FINGER_HALF_WIDTH_M
from envs.tasks.tabletop import (
    FRANKA_AT_TABLE,
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    distance,
    ee_pos,
    nearness,
)

HIT_GAP_M, HIT_REACH_M = 0.05, 0.04
"""Distance of the hand from the ball in the reward, and how near it has to come to there."""

ROLLING_M_S = 0.05
OUT_OF_REACH_M = 0.75
"""Distance of the ball from the base from which the expert gives up."""

NEAR_BASE_M, NEAR_BASE_TIP_RAD = 0.42, 6.0
"""Where the expert begins to tip its fingers back, and by how much for each metre nearer to the base."""

PUSH_M = 0.22
_AHEAD = from_yaw(-np.pi / 2)


@dataclass(frozen=True, kw_only=True)
class RollBall(ArmAtTable):
    """Push a ball so that it rolls over the target at the other end of the table.

    Attributes:
        radius_m: Radius of the ball.
        goal_radius_m: Radius of the target; the ball's centre has to be within.
        spawn_x_m: Range of ball and target along x.
        spawn_y_m: Range of the ball's start along y.
        goal_y_m: Range of the target along y.
    """

    name: ClassVar[str] = "RollBall"
    instructions: ClassVar[tuple[str, ...]] = (
        "roll the ball to the target at the other end of the table",
        "push the blue ball so that it rolls onto the red and white circle",
        "hit the ball towards the goal region",
    )
    max_episode_steps: ClassVar[int] = 160
    robot: ClassVar[RobotCfg] = replace(
        FRANKA_AT_TABLE, pos=(-0.1, 1.0, 0.0), rot=tuple(float(part) for part in _AHEAD)
    )
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, look_at=(-0.1, 0.0, 0.1), fovy_deg=66.0)
    table: ClassVar[TableCfg] = TableCfg(pos=(-0.12, 0.0, 0.0), half_size=(0.8, 1.3))

    radius_m: float = 0.035
    goal_radius_m: float = 0.1
    spawn_x_m: tuple[float, float] = (-0.4, 0.2)
    spawn_y_m: tuple[float, float] = (0.5, 0.7)
    goal_y_m: tuple[float, float] = (-0.9, -0.7)

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        mass = 4 / 3 * np.pi * self.radius_m**3 * DENSITY_KG_M3
        ball = GeomCfg(shape="sphere", size=(self.radius_m,), rgba=BLUE, mass_kg=mass)
        return (
            ObjectCfg(name="ball", geoms=(ball,), pos=(0.0, 0.6, self.radius_m)),
            target("goal", self.goal_radius_m),
        )

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        return {
            "ball": Start((rng.uniform(*self.spawn_x_m), rng.uniform(*self.spawn_y_m), self.radius_m)),
            "goal": Start((rng.uniform(*self.spawn_x_m), rng.uniform(*self.goal_y_m), GOAL_Z_M)),
        }

    @override
    def success(self, state: State) -> Tensor:
        return flat_distance(state.objects["ball"].pos, state.objects["goal"].pos) < self.goal_radius_m

    @override
    def reward(self, state: State) -> Tensor:
        """Returns ManiSkill's: nearness to behind the ball, then that of ball and target."""
        ball, goal = state.objects["ball"], state.objects["goal"].pos
        away = ball.pos - goal
        behind = ball.pos + (self.radius_m + HIT_GAP_M) * away / norm(away)[:, None]
        reach = distance(behind, ee_pos(self.arm(state)))
        left = flat_distance(ball.pos, goal)
        hit = (reach < HIT_REACH_M) | (norm(ball.lin_vel) > ROLLING_M_S)
        return where(hit, 1.0 + 20.0 * (1.0 - tanh(left)), nearness(reach, 2.0)) / 30.0

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the ball's position and velocity, target, end effector, ways between them, (N, 18)."""
        ball, goal = state.objects["ball"], state.objects["goal"].pos
        hand = ee_pos(self.arm(state))
        return concatenate((ball.pos, ball.lin_vel, goal, hand, ball.pos - hand, goal - ball.pos))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        ball, goal = point(state.objects["ball"]), point(state.objects["goal"])
        base = np.array(self.robot.pos)
        if np.linalg.norm((ball - base)[:2]) > OUT_OF_REACH_M:
            return []
        along = (goal - ball) * np.array([1.0, 1.0, 0.0])
        along /= np.linalg.norm(along)
        turn = float(np.arctan2(along[1], along[0]) + np.pi / 2)
        touch = self.radius_m + FINGER_HALF_WIDTH_M
        behind = ball - (touch + rng.uniform(0.012, 0.02)) * along
        near = NEAR_BASE_M - float(np.linalg.norm((behind - base)[:2]))
        tip = float(np.clip(NEAR_BASE_TIP_RAD * near, 0.0, 0.8))
        noise = np.array([*rng.normal(0.0, miss(rng, often_m=0.01, seldom_m=0.03), 2), 0.0])
        # The approach first misses: the next motion demonstrates the correction.
        over = behind + noise + np.array([0.0, 0.0, rng.uniform(0.1, 0.13)])
        end = ball + (PUSH_M - touch) * along
        shut, push_s = GRASP_CLOSED_M, rng.uniform(0.45, 0.55)
        return [
            *self.rise(state, 0.12),
            *approach(way(over, turn, shut, 1.2, pitch=tip), rng, 0.02),
            way(behind, turn, shut, 0.7, 0.15, tip),
            way(end, turn, shut, push_s, 2.5),
        ]

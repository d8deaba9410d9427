"""RollBall, after ManiSkill 3 (``tabletop/roll_ball.py``).

ManiSkill's reward remembers whether the hand has been behind the ball; a state has no memory, so here it
counts the ball's way while the hand is there or the ball rolls.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import concatenate, norm, tanh, where
from envs.kinematics.waypoints import Waypoint, first_miss
from envs.rotations import from_yaw
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, RobotCfg, TableCfg
from envs.state import State
from envs.tasks.arm_at_table import ArmAtTable, Start, above, point, travel_s, way
from envs.tasks.maniskill.parts import BLUE, GOAL_Z_M, target
from envs.tasks.skills.from_above import grasp
from envs.tasks.tabletop import (
    DENSITY_KG_M3,
    FRANKA_AT_TABLE,
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    distance,
    ee_pos,
    flat_distance,
    nearness,
)

HIT_GAP_M, HIT_REACH_M = 0.05, 0.04
"""Distance of the hand from the ball in the reward, and how near it has to come to there."""

ROLLING_M_S = 0.05
OUT_OF_REACH_M = 0.75
"""Distance of the ball from the base from which the expert gives up."""

NEAR_BASE_M, NEAR_BASE_TIP_RAD = 0.42, 5.0
"""Where the expert begins to tip its fingers back, and by how much for each metre nearer to the base."""

LAUNCH_S = (0.35, 0.2, 0.25)
"""Times in which the hand with the ball speeds up, keeps its speed, and slows down."""

LAUNCH_FROM_M = (0.4, 0.44)
"""Range of the ball's distance from the base where the launch begins."""

RELEASE_S, STEP_S, LAUNCH_RISE_M = 0.35, 0.05, 0.1
_AHEAD = from_yaw(-np.pi / 2)


@dataclass(frozen=True, kw_only=True)
class RollBall(ArmAtTable):
    """Make a ball roll over the target at the other end of the table.

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
        "send the blue ball rolling onto the red and white circle",
        "take the ball and roll it towards the goal region",
    )
    max_episode_steps: ClassVar[int] = 200
    own_robot: ClassVar[RobotCfg] = replace(
        FRANKA_AT_TABLE, pos=(-0.1, 1.0, 0.0), rot=tuple(float(part) for part in _AHEAD)
    )
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, look_at=(-0.1, 0.06, 0.1), fovy_deg=70.0)
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
        # The expert carries the ball to where the arm has room to launch it.
        from_base = (ball - base) * np.array([1.0, 1.0, 0.0])
        far = float(np.linalg.norm(from_base))
        start = ball + (float(np.clip(far, *LAUNCH_FROM_M)) / far - 1.0) * from_base
        along = (goal - start) * np.array([1.0, 1.0, 0.0])
        along /= np.linalg.norm(along)
        turn = float(np.arctan2(along[1], along[0]) + np.pi / 2)
        tip = float(np.clip(NEAR_BASE_TIP_RAD * (NEAR_BASE_M - far), 0.0, 0.5))
        # The approach first misses: the next motion demonstrates the correction.
        noise = first_miss(rng, (0.1, 0.13))
        hold, grip, speed = GRASP_OPEN_M, GRASP_CLOSED_M, rng.uniform(0.7, 0.8)
        return [
            *self.rise(state, 0.12),
            *grasp(way(ball + noise, turn, hold, 1.0, pitch=tip), ball, rng, 0.02, down_s=0.6),
            way(above(ball, 0.03), turn, grip, 0.3, 0.0, tip),
            way(above(start, 0.03), turn, grip, travel_s(ball, start) + tip),
            way(above(start, 1e-3), turn, grip, 0.3, 0.1),
            *(launch := _launch(start, along, turn, speed)),
            way(launch[-1].pos, turn, hold, 0.1, 6.0),
        ]


def _launch(ball: np.ndarray, along: np.ndarray, turn: float, speed: float) -> list[Waypoint]:
    """Returns a motion of a held ball, a waypoint for each control step, in which the fingers let go of it.

    The hand speeds up, keeps its speed while the fingers open, and rises out of the ball's way as it slows
    down. A finger that pushed the ball would keep it from rolling, for their friction is 1.
    """
    times = np.cumsum(np.full(round(sum(LAUNCH_S) / STEP_S), STEP_S))
    up, even, down = LAUNCH_S
    share = np.minimum(np.minimum(times / up, 1.0), (up + even + down - times) / down)
    ways = np.cumsum(share) * STEP_S * speed
    heights = 1e-3 + LAUNCH_RISE_M * np.clip((times - up - even) / down, 0.0, 1.0)
    return [
        way(
            above(ball + s * along, height),
            turn,
            GRASP_OPEN_M if t > RELEASE_S else GRASP_CLOSED_M,
            STEP_S,
        )
        for t, s, height in zip(times, ways, heights, strict=True)
    ]

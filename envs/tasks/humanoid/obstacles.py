"""HumanoidBench's further locomotion tasks: crawl, hurdle, stair, slide, pole, maze, sit, balance.

After ``humanoid_bench/envs/{basic_locomotion_envs,pole,maze,balance}.py`` (MIT; Sferrazza et al., RSS 2024),
each with its published reward, ends and bar of the return. What touches what is read as the simulator's last
step found it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, override

import numpy as np
import torch
from torch import Tensor

from envs.controllers import Controller, NormalizedPositionController
from envs.core.errors import SimulatorError
from envs.rotations import from_yaw, uprightness
from envs.scenario import GROUND, ObjectCfg, Vec3
from envs.simulators.base import EnvIds, Handler
from envs.state import EntityState, State
from envs.tasks.humanoid import scenes
from envs.tasks.humanoid.locomotion import UPRIGHT, Walk
from envs.tasks.humanoid.task import ROBOT, HumanoidTask
from envs.tasks.rewards import tolerance

TOUCH_DISCOUNT = 0.1
"""Factor of the reward while the robot touches an obstacle."""


BEHIND: Vec3 = (-3.0, 3.0, 3.0)
"""Camera that sees what is ahead: cam_hurdle of ``robots/h1_pos.xml``."""


def _touched(entity: EntityState, column: int = 0) -> Tensor:
    """Returns whether a thing that an entity feels touches it, 1 or 0, (N,).

    Raises:
        SimulatorError: if the simulator reports no contacts.
    """
    if entity.touched is None:
        raise SimulatorError(
            "This task needs contacts, which this simulator does not report. Take another one, as in: "
            "simulator=mujoco"
        )
    return entity.touched[:, column]


def _discount(entity: EntityState) -> Tensor:
    """Returns what a touch of the first thing that an entity feels leaves of a reward, (N,)."""
    return 1.0 - (1.0 - TOUCH_DISCOUNT) * _touched(entity)


@dataclass(frozen=True, kw_only=True)
class Crawl(HumanoidTask):
    """Crawl on all fours through a low tunnel."""

    name: ClassVar[str] = "humanoid/crawl"
    camera_pos: ClassVar[Vec3] = BEHIND
    instructions: ClassVar[tuple[str, ...]] = ("crawl through the tunnel",)
    success_return: ClassVar[float | None] = 700.0
    fallen_below_m: ClassVar[float | None] = None

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (scenes.TUNNEL,)

    def reward(self, state: State) -> Tensor:
        """Returns small control, height, speed and posture of crawling, in the tunnel, in [0, 1], (N,)."""
        m, rot = self.measures(state), state.robots[ROBOT].rot
        low = torch.minimum(*(tolerance(part[:, 2], 0.6, 1.0, margin=1.0) for part in (m.imu, m.head)))
        off = torch.linalg.vector_norm(rot - rot.new_tensor([0.75, 0.0, 0.65, 0.0]), dim=-1)
        reward = 0.1 * m.small_control + 0.25 * low + 0.4 * m.moving(1.0) + 0.25 * tolerance(off, margin=1.0)
        return reward * tolerance(m.imu[:, 1], -1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Hurdle(Walk):
    """Run over ten hurdles at 5 m/s, and keep off the walls."""

    name: ClassVar[str] = "humanoid/hurdle"
    camera_pos: ClassVar[Vec3] = BEHIND
    instructions: ClassVar[tuple[str, ...]] = ("run over the hurdles",)
    speed_m_s: ClassVar[float] = 5.0

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (scenes.HURDLES, scenes.HURDLE_WALLS)

    @override
    def reward(self, state: State) -> Tensor:
        m = self.measures(state)
        reward = m.small_control * m.standing() * m.straight(0.8) * m.moving(self.speed_m_s)
        return reward * _discount(state.objects["walls"])


@dataclass(frozen=True, kw_only=True)
class Stair(HumanoidTask):
    """Walk up and down flights of stairs at 1 m/s."""

    name: ClassVar[str] = "humanoid/stair"
    camera_pos: ClassVar[Vec3] = BEHIND
    instructions: ClassVar[tuple[str, ...]] = ("walk up and down the stairs",)
    success_return: ClassVar[float | None] = 700.0

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (scenes.STAIRS, scenes.STAIR_WALLS)

    def reward(self, state: State) -> Tensor:
        """Returns head above the feet · upright · small control · moving, in [0, 1], (N,)."""
        m = self.measures(state)
        tall = tolerance(m.head[:, 2:] - m.feet, 1.2, math.inf, margin=0.45).prod(-1)
        return tall * m.straight(0.5) * m.small_control * m.moving(1.0)

    @override
    def failure(self, state: State) -> Tensor:
        # The torso turns about the pelvis's z axis alone, so both point up alike.
        return uprightness(state.robots[ROBOT].rot) < 0.1


@dataclass(frozen=True, kw_only=True)
class Slide(Stair):
    """Walk up and down ramps at 1 m/s."""

    name: ClassVar[str] = "humanoid/slide"
    instructions: ClassVar[tuple[str, ...]] = ("walk up and down the slopes",)

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (scenes.SLIDES, scenes.SLIDE_WALLS)


@dataclass(frozen=True, kw_only=True)
class Pole(HumanoidTask):
    """Walk at 0.5 m/s through a forest of poles, and touch none."""

    name: ClassVar[str] = "humanoid/pole"
    camera_pos: ClassVar[Vec3] = BEHIND
    instructions: ClassVar[tuple[str, ...]] = ("walk between the poles without touching them",)
    success_return: ClassVar[float | None] = 700.0
    fallen_below_m: ClassVar[float | None] = 0.5

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (scenes.POLES, scenes.POLE_WALLS)

    def reward(self, state: State) -> Tensor:
        """Returns the mean of standing and of moving, a tenth of it for a touch, in [0, 1], (N,)."""
        m = self.measures(state)
        standing = m.small_control * m.standing() * m.straight(UPRIGHT)
        return (0.5 * standing + 0.5 * m.moving(0.5)) * _discount(state.objects["poles"])


_CHECKPOINTS: tuple[Vec3, ...] = ((0, 0, 1), (3, 0, 1), (3, 6, 1), (6, 6, 1), (6, 6, -1))
"""Checkpoints that the robot has to pass, m. The last two are one place; the last marker is out of sight."""

_START: Vec3 = (0, 0, 2)
"""Of the marker before the first step, which reaches the first checkpoint and gets its reward."""

_WAYS = ((1, 0), (1, 0), (0, 1), (1, 0), (0, 1))
"""Direction of the way to each."""

_REACHED_M, _MAZE_SPEED_M_S = 0.4, 2.0


@dataclass(frozen=True, kw_only=True)
class Maze(HumanoidTask):
    """Walk through a maze from checkpoint to checkpoint at 2 m/s; the marker shows the next one.

    The next checkpoint is not observed, as published. The reward of reaching the n-th is 100 n.
    """

    name: ClassVar[str] = "humanoid/maze"
    camera_pos: ClassVar[Vec3] = (3.0, 3.0, 3.0)
    instructions: ClassVar[tuple[str, ...]] = ("walk through the maze from marker to marker",)
    success_return: ClassVar[float | None] = 1200.0

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (scenes.MAZE, scenes.CHECKPOINT)

    @property
    @override
    def controller(self) -> Controller:
        return MazeController(self)

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        state = super().initial_state(rngs)
        start = np.tile(np.array(_START, np.float64), (len(rngs), 1))
        state.objects["checkpoint"] = EntityState.at_rest(start, np.array([1.0, 0.0, 0.0, 0.0]))
        return state

    def stages(self, state: State) -> tuple[Tensor, Tensor]:
        """Returns the indices of the checkpoint that is marked, -1 at the start, and of the next, (N,)."""
        marker, pelvis = state.objects["checkpoint"].pos, state.robots[ROBOT].pos
        places = marker.new_tensor((_START, *_CHECKPOINTS))
        row = torch.linalg.vector_norm(marker[:, None] - places, dim=-1).argmin(-1)
        near = torch.linalg.vector_norm(pelvis[:, :2] - places[row][:, :2], dim=-1) < _REACHED_M
        marked = row - 1
        return marked, torch.where(row == 0, 0, (marked + near).clamp(max=len(_CHECKPOINTS) - 1))

    def reward(self, state: State) -> Tensor:
        """Returns standing, moving along the way and nearness, less for a touch, plus checkpoints, (N,)."""
        m = self.measures(state)
        before, now = self.stages(state)
        way = m.com_vel.new_tensor(_WAYS)[now]
        off = m.com_vel[:, :2] - _MAZE_SPEED_M_S * way
        move = tolerance(off, margin=1.0, value_at_margin=0.0, shape="linear").prod(-1)
        move = torch.where(now == len(_CHECKPOINTS) - 1, 1.0, move)
        place = m.imu.new_tensor(_CHECKPOINTS)[now][:, :2]
        near = tolerance(torch.linalg.vector_norm(place - m.imu[:, :2], dim=-1), margin=1.0)
        standing = m.small_control * m.standing() * m.straight(UPRIGHT)
        reward = 0.2 * standing + 0.4 * (5.0 * move + 1.0) / 6.0 + 0.4 * near
        return reward * _discount(state.objects["maze"]) + 100.0 * now * (now > before)


class MazeController(NormalizedPositionController):
    """Marks the next checkpoint where the last one has been reached, and moves the robot.

    Args:
        task: The maze.
    """

    def __init__(self, task: Maze) -> None:
        super().__init__(task.robot)
        self._task = task

    @override
    def apply(self, handler: Handler, actions: np.ndarray | Tensor, env_ids: EnvIds = None) -> None:
        state = handler.get_states(env_ids)
        marker = state.objects["checkpoint"]
        _, now = self._task.stages(state)
        handler.set_poses({"checkpoint": (marker.pos.new_tensor(_CHECKPOINTS)[now], marker.rot)}, env_ids)
        super().apply(handler, actions, env_ids)


@dataclass(frozen=True, kw_only=True)
class SitSimple(HumanoidTask):
    """Sit down on the chair behind, and stay there."""

    name: ClassVar[str] = "humanoid/sit_simple"
    instructions: ClassVar[tuple[str, ...]] = ("sit down on the chair",)
    success_return: ClassVar[float | None] = 750.0
    fallen_below_m: ClassVar[float | None] = 0.5

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (scenes.FIXED_CHAIR,)

    def reward(self, state: State) -> Tensor:
        """Returns how well it sits on the chair, upright, with small control and still, in [0, 1], (N,)."""
        m, pelvis = self.measures(state), state.robots[ROBOT].pos
        off = pelvis - state.objects["chair"].pos
        sitting = tolerance(pelvis[:, 2], 0.68, 0.72, margin=0.2)
        on_chair = tolerance(off[:, 0], -0.19, 0.19, margin=0.2) * tolerance(off[:, 1], margin=0.1)
        posture = tolerance(m.head[:, 2] - m.imu[:, 2], 0.35, 0.45, margin=0.3)
        sits = 0.5 * (sitting + on_chair) * m.straight(0.95, margin=0.9) * posture
        return m.small_control * sits * m.still


@dataclass(frozen=True, kw_only=True)
class SitHard(SitSimple):
    """Sit down on a chair that can be pushed away, from any side of it."""

    name: ClassVar[str] = "humanoid/sit_hard"

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (scenes.CHAIR,)

    @override
    def place(self, rng: np.random.Generator, qpos: np.ndarray) -> None:
        qpos[0], qpos[1] = rng.uniform(0.2, 0.4), rng.uniform(-0.15, 0.15)
        qpos[3:7] = from_yaw(rng.uniform(-1.8, 1.8))


@dataclass(frozen=True, kw_only=True)
class BalanceSimple(HumanoidTask):
    """Stand on a board that tips on a ball that lies still; only the ball may touch the ground."""

    name: ClassVar[str] = "humanoid/balance_simple"
    instructions: ClassVar[tuple[str, ...]] = ("keep your balance on the board",)
    success_return: ClassVar[float | None] = 800.0
    fallen_below_m: ClassVar[float | None] = 0.8
    start_pos: ClassVar[Vec3] = (-0.1, 0.0, 1.38)
    feels: ClassVar[tuple[str, ...]] = (GROUND, "ball")

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (scenes.BOARD, scenes.FIXED_BALL)

    def reward(self, state: State) -> Tensor:
        """Returns standing on the board · upright · small control · not moving, in [0, 1], (N,)."""
        m = self.measures(state)
        return m.small_control * m.standing(1.65 + 0.37) * m.straight(UPRIGHT) * m.still

    @override
    def failure(self, state: State) -> Tensor:
        robot, board = state.robots[ROBOT], state.objects["board"]
        touches = _touched(robot) + _touched(robot, 1) + _touched(board)
        return super().failure(state) | (touches > 0.0)


@dataclass(frozen=True, kw_only=True)
class BalanceHard(BalanceSimple):
    """Stand on a board on a ball that rolls."""

    name: ClassVar[str] = "humanoid/balance_hard"

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (scenes.BOARD, scenes.BALL)

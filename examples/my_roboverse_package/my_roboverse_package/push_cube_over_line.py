"""A task of one's own: push a cube over a line on the table.

A task is a frozen dataclass of pure functions of batched states. Its fields are its options, which a command
sets as in ``task_kwargs.line_x_m=0.2``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import concatenate
from envs.core.errors import ConfigError
from envs.kinematics.waypoints import Waypoint
from envs.rotations import from_yaw
from envs.scenario import GeomCfg, ObjectCfg, ScenarioCfg, TableCfg
from envs.state import EntityState, State
from envs.tasks.base import Task
from envs.tasks.tabletop import CAMERAS, CONTROL_20_HZ, TABLETOP_LOOKS, ee_pos
from my_roboverse_package.robots import FRANKA_ON_BLOCK

HALF_SIZE_M = 0.03
START_M = 0.05
"""Half width of the square on the table in which the cube starts."""


@dataclass(frozen=True, kw_only=True)
class PushCubeOverLine(Task):
    """Push a cube away from the robot until its centre is behind a line.

    Attributes:
        line_x_m: Where the line is, along the x axis of the world.
    """

    name: ClassVar[str] = "PushCubeOverLine"
    instructions: ClassVar[tuple[str, ...]] = ("push the blue cube over the line",)
    max_episode_steps: ClassVar[int] = 100

    line_x_m: float = 0.12

    def __post_init__(self) -> None:
        if not START_M + 0.02 <= self.line_x_m <= 0.2:
            raise ConfigError(f"task_kwargs.line_x_m must be 0.07 to 0.2, given {self.line_x_m}.")

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        box = GeomCfg(shape="box", size=(HALF_SIZE_M,) * 3, mass_kg=0.1, rgba=(0.1, 0.2, 0.9, 1.0))
        line = GeomCfg(shape="box", size=(0.002, 0.2, 0.001), rgba=(1.0, 1.0, 1.0, 1.0))
        return ScenarioCfg(
            robots=(FRANKA_ON_BLOCK,),
            objects=(
                ObjectCfg(name="cube", geoms=(box,), pos=(0.0, 0.0, HALF_SIZE_M)),
                ObjectCfg(name="line", geoms=(line,), pos=(self.line_x_m, 0.0, 0.001), kind="marker"),
            ),
            cameras=CAMERAS,
            appearance=TABLETOP_LOOKS,
            table=TableCfg(pos=(-0.12, 0.0, 0.0), half_size=(0.8, 0.8)),
            physics=CONTROL_20_HZ,
        )

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        count, robot = len(rngs), FRANKA_ON_BLOCK
        cube = np.full((count, 3), HALF_SIZE_M)
        cube[:, :2] = [rng.uniform(-START_M, START_M, 2) for rng in rngs]
        upright = from_yaw(np.zeros(count))
        line = np.tile((self.line_x_m, 0.0, 0.001), (count, 1))
        qpos = np.tile(np.array(robot.default_qpos), (count, 1))
        return State(
            {robot.name: EntityState.at_rest(np.array(robot.pos), np.tile(robot.rot, (count, 1)), qpos)},
            {"cube": EntityState.at_rest(cube, upright), "line": EntityState.at_rest(line, upright)},
        )

    @override
    def success(self, state: State) -> Tensor:
        cube = state.objects["cube"].pos
        return (cube[:, 0] > self.line_x_m) & (cube[:, 2] > 0.5 * HALF_SIZE_M)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns how much of the way to the line is gone, (N,), below 1."""
        left = (self.line_x_m - state.objects["cube"].pos[:, 0]).clamp(0.0, 0.5)
        return 0.9 * (1.0 - 2.0 * left)

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the cube's position and that of the hand, m, (N, 6)."""
        return concatenate((state.objects["cube"].pos, ee_pos(state.robots[FRANKA_ON_BLOCK.name])))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        x, y, _ = state.objects["cube"].pos[0].numpy()
        behind = x - HALF_SIZE_M - 0.06
        end = self.line_x_m - HALF_SIZE_M + 0.02

        def hand(at_x: float, height: float, seconds: float) -> Waypoint:
            pos = np.array([at_x, y + rng.normal(0.0, 0.003), height])
            return Waypoint(pos=pos, yaw=0.0, gripper=0.0, duration_s=seconds)

        return [hand(behind, 0.15, 0.8), hand(behind, 0.03, 0.5), hand(end, 0.03, 1.5)]

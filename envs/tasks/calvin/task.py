"""A CALVIN task as one of ours: a scene, its starts, and a rule of success."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, override

import numpy as np
import torch
from torch import Tensor

from envs.controllers import Controller
from envs.core.errors import ConfigError
from envs.kinematics.waypoints import Waypoint
from envs.scenario import RobotCfg, ScenarioCfg
from envs.state import EntityState, State, concatenated
from envs.tasks.calvin import memory, native
from envs.tasks.calvin.catalogue import BLOCKS, HORIZON, Entry, entries
from envs.tasks.calvin.chain_states import states_before
from envs.tasks.calvin.rules import met
from envs.tasks.calvin.scene import ROBOT, TABLE, scenario_of
from envs.tasks.calvin.sequences import CHAIN_LENGTH
from envs.tasks.calvin.starts import drawn_symbols, initial_state
from envs.tasks.native_spaces import NativeSpaces
from envs.tasks.parameters import parameter
from envs.tasks.planner import Planner
from envs.tasks.tabletop import ee_pos

FIRST_OF_CHAIN = 1 / CHAIN_LENGTH
"""Share of a chain's tasks that begin with the arm in its own posture."""


@dataclass(frozen=True, kw_only=True)
class CalvinTask(NativeSpaces):
    """One of CALVIN's 34 tasks in one of its four scenes.

    Success is CALVIN's: what has changed since the episode began (:mod:`envs.tasks.calvin.rules`).

    Attributes:
        looks: ``boxes`` renders the table's boxes, ``meshes`` CALVIN's meshes and textures; both touch alike.
        starts: ``reset`` begins with the arm in its own posture; ``chain`` does so in a fifth of the
            episodes, and begins the others where another task of a chain of instructions has just ended, of
            which scene D has recorded states (:mod:`envs.tasks.calvin.chain_states`).
        assets_dir: Where CALVIN's files are; None is where ``roboverse assets get calvin`` puts them.
        qpos_noise_rad: Standard deviation of each arm joint's start.
        action_space: ``joints`` for targets of all joints; ``native`` for CALVIN's relative poses.
        observation_space: ``joints`` for positions of all joints; ``native`` for CALVIN's ``robot_obs``; see
            :mod:`envs.tasks.calvin.native`.
    """

    max_episode_steps: ClassVar[int] = HORIZON
    has_reward: ClassVar[bool] = False
    entry: ClassVar[Entry]

    native_names: ClassVar[tuple[str, ...]] = native.STATE_NAMES
    native_limits: ClassVar[tuple[tuple[float, ...], tuple[float, ...]]] = native.STATE_LIMITS

    looks: Literal["boxes", "meshes"] = "boxes"
    starts: Literal["reset", "chain"] = "reset"
    assets_dir: str | None = None
    qpos_noise_rad: float = parameter(0.01, at_least=0.0, at_most=0.05)

    @property
    @override
    def robot(self) -> RobotCfg:
        return ROBOT

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        return scenario_of(self.entry.scene, self.robot, self.looks, self.assets_dir)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.starts == "chain" and (self.entry.scene != "D" or self.robot != ROBOT):
            raise ConfigError(
                f"{self.name} has no starts in the middle of a chain: they were recorded in scene D with "
                "CALVIN's own robot. Give task_kwargs.starts=reset, or a task of calvin/D without robot=."
            )

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        if self.starts == "chain":
            return concatenated([self._chain_start(rng) for rng in rngs])
        return self._reset_state(rngs)

    def _chain_start(self, rng: np.random.Generator) -> State:
        """Returns the start of one episode as in a chain."""
        if rng.random() < FIRST_OF_CHAIN:
            return self._reset_state([rng])
        states, rows = states_before(self.entry.task)
        return states.state(rows[[rng.integers(len(rows))]], self.robot)

    def _reset_state(self, rngs: Sequence[np.random.Generator]) -> State:
        symbols = [drawn_symbols(self.entry.task, rng) for rng in rngs]
        return initial_state(self.entry.scene, self.scenario, symbols, rngs, self.drawn_qpos(rngs))

    def drawn_qpos(self, rngs: Sequence[np.random.Generator]) -> np.ndarray:
        """Returns joints of the robot near its own posture, (N, J)."""
        arm = list(self.robot.arm)
        qpos = np.tile(np.array(self.robot.default_qpos), (len(rngs), 1))
        for row, rng in enumerate(rngs):
            qpos[row, arm] += rng.normal(0.0, self.qpos_noise_rad, len(arm))
        return qpos

    @override
    def success(self, state: State) -> Tensor:
        finite = torch.stack([state.objects[f"block_{colour}"].pos.isfinite().all(-1) for colour in BLOCKS])
        return met(self.entry.facts.rule, state) & finite.all(0)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns 0: CALVIN rewards success alone."""
        return torch.zeros(state.num_envs, dtype=torch.float64, device=state.device)

    @override
    def observe(self, state: State) -> Tensor:
        """Returns hand, joints of the table, lights, poses of blocks, now and at the start, (N, 54)."""
        table = state.objects[TABLE].joint_pos
        lights = torch.stack([memory.led(state)[1], memory.bulb(state)[1]], -1).to(table.dtype)
        parts = [ee_pos(state.robots[self.robot.name]), table, lights, memory.start_joints(state)]
        for colour in BLOCKS:
            for name in (f"block_{colour}", f"start_{colour}"):
                parts += [state.objects[name].pos, state.objects[name].rot]
        return torch.cat(parts, dim=-1)

    @override
    def native_controller(self) -> Controller:
        return native.RelativeCartesianController(self.robot)

    @override
    def native_planner(self) -> Planner:
        return native.RelativeCartesianPlanner(self.scenario, self.expert)

    @override
    def native_state(self, robot: EntityState) -> Tensor:
        return native.robot_obs(self.robot, robot)

    @override
    def same_scene_tasks(self) -> tuple[str, ...]:
        return tuple(
            entry.name
            for entry in entries().values()
            if entry.scene == self.entry.scene and entry != self.entry
        )

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        from envs.tasks.calvin.expert import plan

        return plan(self.entry.scene, self.entry.task, self.robot, state, rng)

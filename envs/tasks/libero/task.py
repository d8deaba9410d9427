"""A LIBERO task as one of ours: a task file's scene, starts and goal."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal, override

import numpy as np
import torch
from torch import Tensor

from envs.core.errors import ConfigError, unknown_name
from envs.kinematics.waypoints import Waypoint
from envs.scenario import ScenarioCfg
from envs.state import State
from envs.tasks.base import Task
from envs.tasks.libero.catalogue import HORIZON, Entry
from envs.tasks.libero.goals import Goal
from envs.tasks.libero.scene import Scene, scene_of
from envs.tasks.libero.starts import starts_of
from envs.tasks.tabletop import ee_pos


@dataclass(frozen=True, kw_only=True)
class LiberoTask(Task):
    """One of LIBERO's 130 tasks, from its files (the extra ``libero``).

    Success is LIBERO's: the atoms of the task file's goal hold together at some step. Objects begin seated:
    see :mod:`envs.tasks.libero.seating`.

    Attributes:
        starts: ``regions`` draws places from the task file's regions; ``libero`` draws one of LIBERO's 50
            initial states, arm included, which have no splits.
    """

    max_episode_steps: ClassVar[int] = HORIZON
    has_reward: ClassVar[bool] = False
    entry: ClassVar[Entry]

    starts: Literal["regions", "libero"] = "regions"

    def __post_init__(self) -> None:
        if self.starts not in ("regions", "libero"):
            raise unknown_name(f"starts of {self.name}", str(self.starts), ("regions", "libero"))

    @property
    def scene(self) -> Scene:
        """The task file and what it became."""
        return scene_of(self.entry)

    @property
    def goal(self) -> Goal:
        """What has to hold."""
        return _goal_of(self.entry)

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        return self.scene.scenario

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        starts = starts_of(self.entry)
        return starts.drawn(rngs) if self.starts == "regions" else starts.of_libero(rngs)

    def fixed_start(self, index: int) -> State:
        """Returns one of LIBERO's 50 initial states, seated, as a state of one row.

        Raises:
            ConfigError: There is none of that index.
        """
        fixed = starts_of(self.entry).fixed
        if not 0 <= index < fixed.num_envs:
            raise ConfigError(f"{self.name} has {fixed.num_envs} fixed starts; given index {index}.")
        return fixed.select([index])

    @override
    def same_scene_tasks(self) -> tuple[str, ...]:
        from envs.tasks.libero.same_scene import same_scene_tasks

        return same_scene_tasks(self.entry)

    @override
    def success(self, state: State) -> Tensor:
        finite = torch.stack([entity.pos.isfinite().all(-1) for entity in state.objects.values()])
        return self.goal.met(state).all(-1) & finite.all(0)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns which share of the goal holds, below 1: LIBERO's own reward is success alone."""
        return 0.99 * self.goal.met(state).double().mean(-1)

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the hand's position, poses of all objects and joints of all fixtures, (N, D)."""
        parts = [ee_pos(state.robots[self.scene.robot.name])]
        for name in (*self.scene.problem.objects, *self.scene.fixtures):
            entity = state.objects[name]
            parts += [entity.pos, entity.rot, entity.joint_pos]
        return torch.cat(parts, dim=-1)

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        from envs.tasks.libero.expert import plan

        return plan(self.scene, self.goal, state, rng)


@lru_cache(maxsize=8)
def _goal_of(entry: Entry) -> Goal:
    return Goal(scene_of(entry))

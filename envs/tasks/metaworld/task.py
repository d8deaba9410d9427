"""A Meta-World task as one of ours: pure functions of states, with Meta-World's own answers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, override

import numpy as np
import torch
from torch import Tensor

from envs.controllers import Controller, PulledHandController
from envs.kinematics.waypoints import Waypoint
from envs.robots.sawyer import SAWYER
from envs.scenario import ScenarioCfg
from envs.state import State
from envs.tasks.base import Task
from envs.tasks.metaworld.original import FRAME_SIZE, Original, Pose, original
from envs.tasks.metaworld.scene import PULLER, PULLER_ROT, MetaworldScene, scene_of

HORIZON = 500
"""Meta-World's ``max_path_length``."""

MAX_REWARD = 10.0

BELOW_ONE = 0.999
"""Largest reward of a state that is no success; a few of Meta-World's rewards reach 10 a little early."""


@dataclass(frozen=True, kw_only=True)
class MetaWorldTask(Task):
    """Base of the 50 tasks. Success, reward and observation are Meta-World's, row by row.

    The observation is Meta-World's of MT1, where the goal is seen, without its second frame: a frame
    (hand, opening of the gripper, positions and orientations of up to two objects, zeros) and the goal.

    Attributes:
        original_name: Meta-World's name of the task.
    """

    max_episode_steps: ClassVar[int] = HORIZON
    original_name: ClassVar[str]

    @property
    def original(self) -> Original:
        """Meta-World's own environment."""
        return original(self.original_name)

    @property
    def scene(self) -> MetaworldScene:
        """The scenario, and the way to Meta-World's arrays."""
        return scene_of(self.original)

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        return self.scene.scenario

    @property
    @override
    def controller(self) -> Controller:
        env = self.original.env
        return PulledHandController(
            SAWYER,
            PULLER,
            low=tuple(env.mocap_low),
            high=tuple(env.mocap_high),
            step_m=env.action_scale,
            rot=PULLER_ROT,
        )

    @property
    @override
    def planner(self) -> "ScriptedPlanner":
        return ScriptedPlanner(self)

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        vectors = np.stack([self.original.draw(rng) for rng in rngs])
        episodes = [self.original.episode(vector) for vector in vectors]
        goals = np.stack([episode.goal for episode in episodes])
        return self.scene.state([episode.start for episode in episodes], goals, vectors)

    @override
    def success(self, state: State) -> Tensor:
        return torch.from_numpy(self._answers(state)[2])

    @override
    def reward(self, state: State) -> Tensor:
        """Returns Meta-World's reward over 10."""
        return torch.from_numpy(np.clip(self._answers(state)[1] / MAX_REWARD, 0.0, BELOW_ONE))

    @override
    def observe(self, state: State) -> Tensor:
        """Returns a frame and the goal, (N, 21)."""
        return torch.from_numpy(self._answers(state)[0])

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        return []  # the planner follows Meta-World's scripted policy instead

    def _answers(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns observations (N, 21), rewards (N,) and successes (N,) of Meta-World's own code."""
        poses, vectors = self.scene.poses(state)
        rows = [
            (pose.qpos, pose.qvel, pose.ctrl, pose.mocap_pos, pose.body_pos, vector)
            for pose, vector in zip(poses, vectors, strict=True)
        ]
        # Success, reward and observation of one state are read one after the other.
        key = b"".join(values.tobytes() for numbers in rows for values in numbers)
        if self.original.last_answers[0] != key:
            self.original.last_answers = key, self._ask(rows, poses)
        observations, rewards, successes = self.original.last_answers[1]
        return observations.copy(), rewards.copy(), successes.copy()

    def _ask(
        self, rows: list[tuple[np.ndarray, ...]], poses: list[Pose]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        observations = np.full((len(poses), FRAME_SIZE + 3), np.nan)
        rewards, successes = np.zeros(len(poses)), np.zeros(len(poses), bool)
        for row, (numbers, pose) in enumerate(zip(rows, poses, strict=True)):
            if all(np.isfinite(values).all() for values in numbers):
                seen, rewards[row], successes[row] = self.original.evaluate(numbers[-1], pose)
                observations[row] = np.delete(seen, np.s_[FRAME_SIZE : 2 * FRAME_SIZE])
        return observations, rewards, successes


class ScriptedPlanner:
    """Plans one action at a time with Meta-World's scripted policy.

    Args:
        task: The task.
    """

    def __init__(self, task: MetaWorldTask) -> None:
        self._task = task

    def plan(self, state: State, rng: np.random.Generator) -> np.ndarray:
        """Returns one action (1, 4) float32; see :class:`envs.tasks.planner.Planner`."""
        return self.plan_batch(state, (rng,))[0]

    def plan_batch(self, state: State, rngs: Sequence[np.random.Generator]) -> list[np.ndarray]:
        """Returns one action (1, 4) float32 per row; see :class:`envs.tasks.planner.BatchPlanner`."""
        seen = self._task.observe(state).cpu().numpy()
        # No policy uses the previous frame, so the present one takes its place.
        whole = np.concatenate([seen[:, :FRAME_SIZE], seen], axis=1)
        return [self._task.original.action(row)[None].astype(np.float32) for row in whole]

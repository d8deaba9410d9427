"""Runs scripted experts: planners that turn states into actions."""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import override

import numpy as np

from envs.randomization import channel_rng
from envs.rollout import Actor, Episode, OnStep, in_order, rollout
from envs.state import State
from envs.tasks.plan_following import TAIL_STEPS, plan_all, plan_each
from envs.tasks.planner import Planner
from envs.vector_env import RoboVerseVectorEnv


class ExpertActor(Actor):
    """Follows the plans of an expert until a few steps after success, or the task's limit of steps.

    Args:
        env: The environment.
        planner: Makes the plans; the task's by default. It plans for many states at once if it can; on a
            simulator that steps all environments together, as fast as it can, up to rounding.
    """

    tail_steps = TAIL_STEPS

    def __init__(self, env: RoboVerseVectorEnv, planner: Planner | None = None) -> None:
        self._planner = env.task.planner if planner is None else planner
        self._limit, self._seed = env.max_episode_steps, env.protocol_seed
        self._at_once = env.handler.steps_together
        self._controller = env.controller

    @override
    def begin(self, episodes: Sequence[Episode]) -> None:
        for episode in episodes:
            episode.memory = channel_rng(self._seed, "expert", episode.episode)

    @override
    def act(self, episodes: Sequence[Episode], states: Callable[[], State]) -> list[np.ndarray]:
        going = [row for row, episode in enumerate(episodes) if episode.length < self._limit]
        chunks: list[np.ndarray] = [np.zeros((0, 0), np.float32)] * len(episodes)
        if not going:
            return chunks
        rngs, present = [episodes[row].memory for row in going], states().select(going)
        plans = (plan_all if self._at_once else plan_each)(self._planner, present, rngs)
        for row, plan in zip(going, plans, strict=True):
            episode = episodes[row]
            actions = self._controller.of_joint_targets(plan)
            if not len(plan) and episode.success and episode.last_action is not None:
                actions = episode.last_action[None]
            chunks[row] = actions[: self._limit - episode.length]
        return chunks


def expert_episodes(
    env: RoboVerseVectorEnv,
    episodes: Iterable[int],
    planner: Planner | None = None,
    *,
    record: Collection[str] = ("images", "states"),
    on_step: OnStep = lambda episode: None,
) -> Iterator[Episode]:
    """Yields episodes of the expert, or of another planner, in the order of ``episodes``.

    ``record`` and ``on_step`` are those of :func:`~envs.rollout.rollout`.
    """
    return in_order(rollout(env, ExpertActor(env, planner), episodes, record=record, on_step=on_step))

"""Runs the pieces of generated demonstrations in a rollout."""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, override

import numpy as np

from envs.randomization import channel_rng
from envs.rollout import Actor, Episode, in_order, rollout
from envs.state import State
from envs.tasks.plan_following import TAIL_STEPS
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.data.augmentation.planner import AugmentPlanner

CHANNEL = "augment"
"""Name of the stream of an episode's random numbers."""


class MadeOf(NamedTuple):
    """What a piece of an episode is made from.

    Attributes:
        reference: Object or part that the hand moved relative to.
        carried: Object that it carried, or empty.
        demonstration: Index of the source in its dataset.
    """

    reference: str
    carried: str
    demonstration: int


@dataclass(eq=False)
class Progress:
    """How far an episode is.

    Attributes:
        rng: Its random numbers.
        stage: Its next piece.
        made_of: What each planned piece is made from.
        retries: How often a subtask was restarted.
    """

    rng: np.random.Generator
    stage: int = 0
    made_of: "list[MadeOf]" = field(default_factory=list)
    retries: int = 0


class AugmentActor(Actor):
    """Follows plans of pieces until a few steps after success, or the task's limit of steps.

    A subtask restarts where the hand holds nothing when it should carry, and the last one where the
    task is not solved at its end.

    Args:
        env: The environment.
        planner: Makes the plans.
        max_retries: How often an episode may begin a subtask again.
    """

    tail_steps = TAIL_STEPS

    def __init__(self, env: RoboVerseVectorEnv, planner: AugmentPlanner, max_retries: int) -> None:
        self._planner, self._max_retries, self._controller = planner, max_retries, env.controller
        self._limit, self._seed = env.max_episode_steps, env.protocol_seed

    @override
    def begin(self, episodes: Sequence[Episode]) -> None:
        for episode in episodes:
            episode.memory = Progress(channel_rng(self._seed, CHANNEL, episode.episode))

    @override
    def act(self, episodes: Sequence[Episode], states: Callable[[], State]) -> list[np.ndarray]:
        present = states()
        return [self._chunk(episode, present.select([row])) for row, episode in enumerate(episodes)]

    def _chunk(self, episode: Episode, state: State) -> np.ndarray:
        """Returns the next actions of an episode; none gives up."""
        progress: Progress = episode.memory
        left = self._limit - episode.length
        if left > 0 and episode.success and episode.last_action is not None:
            return episode.last_action[None]
        if left <= 0 or not self._next_stage(progress, state):
            return np.zeros((0, 0), np.float32)
        before = progress.made_of[-1].demonstration if progress.made_of else None
        plan = self._planner.plan(state, progress.rng, progress.stage, before)
        reference, carried, _ = self._planner.roles[progress.stage]
        progress.made_of.append(MadeOf(reference, carried, plan.source))
        progress.stage += 1
        return self._controller.of_joint_targets(plan.targets[:left])

    def _next_stage(self, progress: Progress, state: State) -> bool:
        """Goes back to where a subtask begins that failed; returns whether there is a next piece."""
        last = len(self._planner.roles) - 1
        ended = progress.stage > last
        if not ended and self._planner.holds(state, progress.stage):
            return True
        progress.retries += 1
        progress.stage = self._planner.begins_at(min(progress.stage, last))
        return progress.retries <= self._max_retries


def augmented_episodes(
    env: RoboVerseVectorEnv,
    episodes: Iterable[int],
    planner: AugmentPlanner,
    max_retries: int,
    *,
    record: Collection[str] = ("images", "states"),
) -> Iterator[Episode]:
    """Yields generated episodes, solved or not, in the order of ``episodes``."""
    return in_order(rollout(env, AugmentActor(env, planner, max_retries), episodes, record=record))

"""Runs retargeted hand paths in a rollout."""

from collections.abc import Callable, Collection, Iterator, Sequence
from typing import override

import numpy as np

from envs.playback import HOLD_STEPS, concatenated
from envs.rollout import Actor, Episode, in_order, rollout
from envs.state import State
from envs.tasks.plan_following import TAIL_STEPS
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.data.retargeting.hand_path import HandPath
from roboverse_learn.data.retargeting.planner import RetargetedPath, RetargetPlanner


class RetargetActor(Actor):
    """Starts episodes with the objects of recordings, and follows their hand paths until after success.

    The robot starts as the task samples it. An episode's ``memory`` is its
    :class:`~roboverse_learn.data.retargeting.planner.RetargetedPath`.

    Args:
        env: The environment.
        planner: Follows paths with its robot.
        starts: Initial state of each recording, one row each; its robots are left out.
        paths: Hand path of each recording.
    """

    tail_steps = TAIL_STEPS

    def __init__(
        self,
        env: RoboVerseVectorEnv,
        planner: RetargetPlanner,
        starts: Sequence[State],
        paths: Sequence[HandPath],
    ) -> None:
        self._planner, self._paths, self._limit = planner, paths, env.max_episode_steps
        self._controller = env.controller
        self._starts = [State({}, start.objects) for start in starts]

    @override
    def begin(self, episodes: Sequence[Episode]) -> State:
        return concatenated([self._starts[episode.position] for episode in episodes])

    @override
    def act(self, episodes: Sequence[Episode], states: Callable[[], State]) -> list[np.ndarray]:
        fresh = [row for row, episode in enumerate(episodes) if episode.memory is None]
        if fresh:
            paths = [self._paths[episodes[row].position] for row in fresh]
            plans = self._planner.plan(states().select(fresh), paths)
            for row, plan in zip(fresh, plans, strict=True):
                episodes[row].memory = plan
        return [self._controller.of_joint_targets(self._chunk(episode)) for episode in episodes]

    def _chunk(self, episode: Episode) -> np.ndarray:
        """Returns the next joint targets of an episode: its path, then its last target; none gives up."""
        plan: RetargetedPath = episode.memory
        left = self._limit - episode.length
        if episode.length < len(plan.targets) + HOLD_STEPS:
            steps = np.arange(episode.length, len(plan.targets) + HOLD_STEPS)
            return plan.targets[np.minimum(steps, len(plan.targets) - 1)][: max(left, 0)]
        if left > 0 and episode.success:  # the tail after a late success
            return plan.targets[-1:]
        return plan.targets[:0]


def retargeted_episodes(
    env: RoboVerseVectorEnv,
    episodes: Sequence[int],
    planner: RetargetPlanner,
    starts: Sequence[State],
    paths: Sequence[HandPath],
    *,
    record: Collection[str] = ("images", "states"),
) -> Iterator[Episode]:
    """Yields retargeted episodes, solved or not, in the order of ``episodes``."""
    return in_order(rollout(env, RetargetActor(env, planner, starts, paths), episodes, record=record))

"""Replays recordings: by their controls, where physics decides, or by their states, which are set."""

import math
from collections.abc import Callable, Sequence
from typing import Any, override

import numpy as np

from envs.batched_env import StepResult
from envs.rollout import Actor, Episode
from envs.state import State, concatenated
from envs.vector_env import RoboVerseVectorEnv

HOLD_STEPS = 10
"""Control steps for which a replay holds the last action: half a second for an arm that lags behind."""


class ReplayActor(Actor):
    """Starts each episode in a recorded state and gives the recorded actions.

    Args:
        starts: Initial state of each episode, one row each.
        actions: Actions of each episode, (T, A).
        hold_steps: Control steps for which the last action is repeated.
        tail_steps: Control steps for which an episode continues after its first success.
    """

    def __init__(
        self,
        starts: Sequence[State],
        actions: Sequence[np.ndarray],
        *,
        hold_steps: int = HOLD_STEPS,
        tail_steps: float = math.inf,
    ) -> None:
        self._starts, self._actions, self._hold_steps = starts, actions, hold_steps
        self.tail_steps = tail_steps

    @override
    def begin(self, episodes: Sequence[Episode]) -> State:
        return concatenated([self._starts[episode.position] for episode in episodes])

    @override
    def act(self, episodes: Sequence[Episode], states: Callable[[], State]) -> list[np.ndarray]:
        del states
        return [self._rest(self._actions[episode.position], episode.length) for episode in episodes]

    def _rest(self, actions: np.ndarray, begin: int) -> np.ndarray:
        steps = np.arange(begin, len(actions) + self._hold_steps)
        return actions[np.minimum(steps, len(actions) - 1)].astype(np.float32)


class PlaybackEnv:
    """A batched environment that steps through recorded states instead of physics.

    Args:
        env: The environment.
        recordings: The states that environment ``i`` steps through, from the first one on; at most
            ``num_envs`` of them.
    """

    def __init__(self, env: RoboVerseVectorEnv, recordings: Sequence[State]) -> None:
        self._env, self._recordings = env, recordings
        self._steps = np.zeros(env.num_envs, np.int64)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def step_envs(self, env_ids: np.ndarray, actions: np.ndarray) -> StepResult:
        """Sets the next states of these environments, whatever the actions."""
        del actions
        self._steps[env_ids] += 1
        ids = env_ids.tolist()
        lasts = [self._recordings[i].num_envs - 1 for i in ids]
        steps = np.minimum(self._steps[env_ids], lasts).tolist()
        rows = [self._recordings[i].select([step]) for i, step in zip(ids, steps, strict=True)]
        states, success = set_and_judge(self._env, env_ids, concatenated(rows))
        reward = np.where(success, 1.0, self._env.task.reward(states).cpu().numpy())
        return StepResult(reward, success, np.zeros_like(success), success)


def set_and_judge(
    env: RoboVerseVectorEnv, env_ids: Sequence[int] | np.ndarray, states: State
) -> tuple[State, np.ndarray]:
    """Sets environments to recorded states; returns the states read back, and their success (n,) bool."""
    handler = env.handler
    handler.set_states(states.to(handler.device, handler.dtype), env_ids)
    found = env.get_states(env_ids)
    return found, env.task.success(found).cpu().numpy()

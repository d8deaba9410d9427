"""Looks that change within an episode: materials, lights, and poses of fixed cameras.

Where every demonstration has one look of its own, a policy can tell demonstrations apart by their looks, and
learn each one's path by heart instead of looking at the objects. A look that changes every few steps says
nothing of the path. Physics, actions and the observed joints stay as they are.
"""

from typing import TYPE_CHECKING

import numpy as np

from envs.randomization import channel_rng
from envs.scenario import Appearance

if TYPE_CHECKING:
    from envs.episode import Episode
    from envs.rollout import OnStep
    from envs.vector_env import RoboVerseVectorEnv

NUM_LOOKS = 4_000
"""Looks that episodes change to, at most: those of a split's first episodes, as many as a GPU keeps ready."""


def changing_looks(env: "RoboVerseVectorEnv", steps: int) -> "OnStep":
    """Returns what changes the looks of episodes after every so many steps; of 0 steps, it keeps them."""
    return ChangingLooks(env, steps) if steps else lambda episode: None


class ChangingLooks:
    """Gives an episode the look of another episode of its split after every few control steps.

    It begins with its own look. Which ones follow depends on the episode's index and the environment's
    protocol seed alone.

    Args:
        env: The environments, whose appearances are changed.
        steps: Control steps for which a look stays.
    """

    def __init__(self, env: "RoboVerseVectorEnv", steps: int) -> None:
        self._env, self._steps = env, steps
        self._pool = env.split_indices[:NUM_LOOKS].tolist()
        self._looks: dict[int, Appearance] = {}
        self._rngs: dict[int, np.random.Generator] = {}  # by environment

    def __call__(self, episode: "Episode") -> None:
        """Changes the look of an episode that has begun or has made a step, if it is time to."""
        if episode.length % self._steps:
            return
        if not episode.length:
            self._rngs[episode.env_id] = channel_rng(self._env.protocol_seed, "looks", episode.episode)
            return
        index = self._pool[self._rngs[episode.env_id].integers(len(self._pool))]
        if index not in self._looks:
            self._looks[index] = self._env.randomizer.appearance(index)
        self._env.handler.change_look(self._looks[index], episode.env_id)

"""Small deterministic episodes, and a source of them that worker processes import by name."""

import itertools
import os
import signal
import time
from collections.abc import Iterator

import numpy as np

from envs.core.errors import ConfigError
from roboverse_learn.data import EpisodeData, make_features

FPS = 20
SIZE = 32
FEATURES = make_features(
    [f"joint{i}" for i in range(3)], ["x", "y"], {"front": (SIZE, SIZE)}, reward=True, success=True
)
TWO_CAMERAS = make_features(["q"], ["u"], {"front": (SIZE, SIZE), "wrist": (16, 48)})


def make_episode(index: int, length: int | None = None, task: str = "lift the cube") -> EpisodeData:
    """Returns the ``index``-th episode of the pool: smooth pictures, random numbers."""
    rng = np.random.default_rng(index)
    length = length or int(rng.integers(4, 9))
    y, x = np.mgrid[0:SIZE, 0:SIZE]
    shift = np.arange(length)[:, None, None]
    red = 128 + 100 * np.sin((x + 3 * shift + index) / 9)
    green = 128 + 100 * np.cos((y + 2 * shift) / 11)
    images = np.stack([red, green, np.full_like(red, 20 * (index % 10))], axis=-1).astype(np.uint8)
    return EpisodeData(
        states=rng.normal(size=(length, 3)).astype(np.float32),
        actions=rng.normal(size=(length, 2)).astype(np.float32),
        images={"front": images},
        task=task,
        raw={"qpos": rng.normal(size=(length + 1, 5)), "ctrl": rng.normal(size=(length, 2))},
        metadata={"task": "PickCube", "level": 0, "split": "train", "episode": index},
        rewards=rng.normal(size=length).astype(np.float32),
        successes=np.arange(length) == length - 1,
    )


class SyntheticSource:
    """Fails every ``fail_every``-th pool episode, and looks ahead like a batched environment."""

    def __init__(
        self, fail_every: int = 4, lookahead: int = 2, delay_s: float = 0.0, die_at: int = -1
    ) -> None:
        self._fail_every, self._lookahead, self._delay_s = fail_every, lookahead, delay_s
        self._die_at = die_at
        self.closed = False

    def attempts(self, indices: Iterator[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        """Yields batches of episodes in reverse order."""
        while batch := list(itertools.islice(indices, self._lookahead)):
            for index in reversed(batch):
                if index == self._die_at:
                    os.kill(os.getpid(), signal.SIGKILL)
                time.sleep(self._delay_s)
                yield index, None if index % self._fail_every == 0 else make_episode(index)

    def close(self) -> None:
        """Nothing to release."""
        self.closed = True


def make_source(**kwargs: float) -> SyntheticSource:
    """Returns a source, as a collection's configuration names it."""
    return SyntheticSource(**kwargs)


class ForgetfulSource:
    """Takes indices and drops every second one; sleeps where ``slow_at`` is taken."""

    def __init__(self, slow_at: int = -1) -> None:
        self._slow_at = slow_at

    def attempts(self, indices: Iterator[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        """Yields every second episode that it takes."""
        for position, index in enumerate(indices):
            if index == self._slow_at:
                time.sleep(60)  # until the collection has heard another worker and stops this one
            if position % 2:
                yield index, make_episode(index)

    def close(self) -> None:
        """Nothing to release."""


def make_forgetful_source(slow_at: int = -1) -> ForgetfulSource:
    """Returns a source that breaks its promise."""
    return ForgetfulSource(slow_at)


def make_broken_source() -> SyntheticSource:
    """Fails as a mistyped task does."""
    raise ConfigError("Unknown task 'PickCub'. Did you mean 'PickCube'?")

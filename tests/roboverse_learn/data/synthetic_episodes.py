"""Small deterministic episodes, and a source of them that worker processes import by name."""

import os
import time
from collections.abc import Iterator, Sequence

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
    """Returns the ``index``-th episode of the pool: smooth images, random numbers."""
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
    """Fails every ``fail_every``-th pool episode, and yields a batch in reverse order."""

    def __init__(self, fail_every: int = 4, delay_s: float = 0.0, die_at: int = -1) -> None:
        self._fail_every, self._delay_s, self._die_at = fail_every, delay_s, die_at

    def attempts(self, indices: Sequence[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        """Yields what became of each pool episode."""
        for index in reversed(indices):
            if index == self._die_at:
                os._exit(9)
            time.sleep(self._delay_s)
            yield index, None if index % self._fail_every == 0 else make_episode(index)

    def close(self) -> None:
        """Nothing to release."""


class ForgetfulSource(SyntheticSource):
    """Drops every second pool episode."""

    def attempts(self, indices: Sequence[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        """Yields the others."""
        return super().attempts(indices[::2])


class BrokenSource(SyntheticSource):
    """Fails as a mistyped task does."""

    def __init__(self) -> None:
        raise ConfigError("Unknown task 'PickCub'. Did you mean 'PickCube'?")

"""Random order of training frames that can be resumed at any batch."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from envs.core.errors import ConfigError
from roboverse_learn.data.dataset.info import DatasetInfo


class EpisodeAwareSampler:
    """Samples frames without replacement, epoch after epoch, in full batches.

    The order is a function of (seed, epoch) alone, so two numbers are its whole state.

    Args:
        info: The dataset.
        batch_size: Frames per batch over all processes.
        seed: Seed of the order.
        episodes: Episodes to sample from; all by default.
        drop_last_frames: Frames left out at the end of every episode.
        rank: Which of ``world_size`` processes this is; it gets every ``world_size``-th frame of a batch.
        world_size: Number of training processes.

    Raises:
        ConfigError: No frame is left, or the batch does not divide over the processes.
    """

    def __init__(
        self,
        info: DatasetInfo,
        *,
        batch_size: int,
        seed: int,
        episodes: Sequence[int] | None = None,
        drop_last_frames: int = 0,
        rank: int = 0,
        world_size: int = 1,
    ) -> None:
        if batch_size < 1 or batch_size % world_size:
            raise ConfigError(
                f"batch_size {batch_size} must be a positive multiple of {world_size} processes."
            )
        chosen = np.arange(info.num_episodes) if episodes is None else np.asarray(episodes, dtype=np.int64)
        ends = np.maximum(info.episode_ends[chosen] - drop_last_frames, info.episode_starts[chosen])
        ranges = [np.arange(s, e) for s, e in zip(info.episode_starts[chosen], ends, strict=True)]
        self._frames = np.concatenate(ranges) if ranges else np.empty(0, dtype=np.int64)
        if not len(self._frames):
            raise ConfigError(
                f"No frame of {len(chosen)} episodes is left after dropping {drop_last_frames} from the end "
                "of each. Choose more episodes or drop fewer frames."
            )
        self._batch_size, self._seed = batch_size, seed
        self._rank, self._world_size = rank, world_size
        self._epoch = self._position = 0
        self._order = self._permutation(0)

    @property
    def num_frames(self) -> int:
        """Frames of one epoch."""
        return len(self._frames)

    @property
    def epoch(self) -> int:
        """The epoch that the next frame belongs to, from 0."""
        return self._epoch

    @property
    def num_sampled(self) -> int:
        """Frames that were sampled so far, over all epochs and processes."""
        return self._epoch * self.num_frames + self._position

    def next_batch(self) -> np.ndarray:
        """Returns this process's frames of the next batch, int64 (batch_size / world_size,)."""
        return self.next_frames(self._batch_size)[self._rank :: self._world_size]

    def next_frames(self, number: int) -> np.ndarray:
        """Returns the next frames of the order, int64 (number,)."""
        parts: list[np.ndarray] = [np.empty(0, dtype=np.int64)]
        missing = number
        while missing:
            if self._position == len(self._order):
                self._epoch, self._position = self._epoch + 1, 0
                self._order = self._permutation(self._epoch)
            part = self._order[self._position : self._position + missing]
            self._position += len(part)
            missing -= len(part)
            parts.append(part)
        return np.concatenate(parts)

    def state_dict(self) -> dict[str, int]:
        """Returns the position in the order."""
        return {"epoch": self._epoch, "position": self._position}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from a position that :meth:`state_dict` gave."""
        self._epoch, self._position = int(state["epoch"]), int(state["position"])
        self._order = self._permutation(self._epoch)

    def _permutation(self, epoch: int) -> np.ndarray:
        generator = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(epoch,)))
        return generator.permutation(self._frames)


class MixtureSampler:
    """Samples several groups of episodes, each by a fixed share of every batch.

    A group's share is in proportion to its frames to the power ``mixing``: 0 samples groups equally often,
    1 frames. A batch holds the frames of one group after those of another. Fractions of a frame add up over
    batches.

    Args:
        info: The dataset.
        groups: Episodes of each group.
        batch_size: Frames per batch over all processes, at least one of each group.
        seed: Seed of the order.
        mixing: From 0 to 1.
        drop_last_frames: Frames left out at the end of every episode.
        rank: Which of ``world_size`` processes this is; it gets every ``world_size``-th frame of a batch.
        world_size: Number of training processes.

    Raises:
        ConfigError: A group has no frame left, or less than one in a batch, or the batch does not divide
            over the processes.
    """

    def __init__(
        self,
        info: DatasetInfo,
        groups: Sequence[np.ndarray],
        *,
        batch_size: int,
        seed: int,
        mixing: float = 0.0,
        drop_last_frames: int = 0,
        rank: int = 0,
        world_size: int = 1,
    ) -> None:
        self._members = [
            EpisodeAwareSampler(
                info,
                batch_size=1,
                seed=int(np.random.SeedSequence(seed, spawn_key=(index,)).generate_state(1)[0]),
                episodes=episodes.tolist(),
                drop_last_frames=drop_last_frames,
            )
            for index, episodes in enumerate(groups)
        ]
        frames = [member.num_frames for member in self._members]
        self._shares = shares_of_a_batch(frames, batch_size, mixing, world_size)
        self._batch_size, self._rank, self._world_size = batch_size, rank, world_size
        self._batches = 0

    @property
    def num_frames(self) -> int:
        """Frames of all groups."""
        return sum(member.num_frames for member in self._members)

    def next_batch(self) -> np.ndarray:
        """Returns this process's frames of the next batch, int64 (batch_size / world_size,)."""
        numbers = self._drawn(self._batches + 1) - self._drawn(self._batches)
        self._batches += 1
        frames = [member.next_frames(number) for member, number in zip(self._members, numbers, strict=True)]
        return np.concatenate(frames)[self._rank :: self._world_size]

    def _drawn(self, batches: int) -> np.ndarray:
        """Returns how many frames of each group so many batches have, int64 (groups,).

        What whole frames leave over goes to the groups with the largest fractions. A share of at least one
        frame keeps these numbers from falling from batch to batch.
        """
        exact = batches * self._shares
        whole = np.floor(exact).astype(np.int64)
        left = batches * self._batch_size - int(whole.sum())
        whole[np.argsort(whole - exact, kind="stable")[:left]] += 1
        return whole

    def state_dict(self) -> dict[str, Any]:
        """Returns the position in the order of each group."""
        return {"groups": [member.state_dict() for member in self._members]}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from a position that :meth:`state_dict` gave, also before there was ``mixing``.

        How many batches there were follows from the frames that were sampled.
        """
        for member, own in zip(self._members, state["groups"], strict=True):
            member.load_state_dict(own)
        self._batches = sum(member.num_sampled for member in self._members) // self._batch_size


def shares_of_a_batch(
    frames: Sequence[int], batch_size: int, mixing: float, world_size: int = 1, *, guessed: bool = False
) -> np.ndarray:
    """Returns how many frames of each group a batch has on average, float64 (groups,).

    Args:
        frames: Of each group.
        batch_size: Of :class:`MixtureSampler`, as what follows.
        mixing: From 0 to 1.
        world_size: Number of training processes.
        guessed: The frames are not known yet, so a batch that serves them may still be too small.

    Raises:
        ConfigError: A group has no frame, or less than one in a batch, or the batch does not divide over
            the processes.
    """
    if min(frames) < 1:
        raise ConfigError(
            f"{sum(each < 1 for each in frames)} of {len(frames)} tasks have no frame in the dataset. Give "
            "one with demonstrations of every task, or learn those that have some."
        )
    shares = _shares(frames, batch_size, mixing)
    if batch_size % world_size or shares.min() < 1.0:
        raise ConfigError(
            f"train.batch_size={batch_size} must be a multiple of {world_size} processes, and have at "
            f"least one frame of each of {len(frames)} tasks, of which one has a share of "
            f"{shares.min():.2g}. Give {_what_fits(frames, batch_size, mixing, world_size, guessed)}."
        )
    return shares


def _shares(frames: Sequence[int], batch_size: int, mixing: float) -> np.ndarray:
    weights = np.array(frames) ** float(mixing)
    return batch_size * weights / weights.sum()


def _what_fits(frames: Sequence[int], batch_size: int, mixing: float, world_size: int, guessed: bool) -> str:
    """Returns words for the least larger batch that serves, and the largest mixing if a smaller one does."""
    least = max(batch_size, math.ceil(1.0 / _shares(frames, 1, mixing).min()))
    least = math.ceil(least / world_size) * world_size
    while _shares(frames, least, mixing).min() < 1.0:  # the quotient was rounded down
        least += world_size
    if guessed and mixing:
        return (
            f"train.batch_size of at least {least}: with train.mixing={mixing:g} a task that turns out to "
            "have fewer frames than others needs more"
        )
    words = f"train.batch_size={least} or more"
    if batch_size % world_size or batch_size < len(frames):
        return words  # of no mixing
    hundredths = range(math.floor(100 * mixing), 0, -1)
    fitting = (each / 100 for each in hundredths if _shares(frames, batch_size, each / 100).min() >= 1.0)
    return f"{words}, or train.mixing of at most {next(fitting, 0.0):g}"


def make_sampler(
    dataset: Any, *, mixing: float = 0.0, **settings: Any
) -> EpisodeAwareSampler | MixtureSampler:
    """Returns the sampler of a dataset: of a mixture, where it names ``groups`` of episodes.

    Args:
        dataset: What a policy is trained on.
        mixing: Of :class:`MixtureSampler`.
        settings: Of either sampler: ``batch_size``, ``seed``, ``drop_last_frames``, ``rank``, ``world_size``.
    """
    groups = getattr(dataset, "groups", ())
    if groups:
        return MixtureSampler(dataset.info, groups, mixing=mixing, **settings)
    return EpisodeAwareSampler(dataset.info, **settings)

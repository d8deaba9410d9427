"""The order of training frames: every frame once per epoch, every process its own share."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envs.core.errors import ConfigError
from roboverse_learn.data import EpisodeAwareSampler


def dataset(lengths):
    ends = np.cumsum(lengths)
    return SimpleNamespace(num_episodes=len(lengths), episode_starts=ends - lengths, episode_ends=ends)


datasets = st.lists(st.integers(1, 9), min_size=1, max_size=6)


@given(lengths=datasets, batch_size=st.integers(1, 20), seed=st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_every_epoch_has_every_frame_once(lengths, batch_size, seed):
    """Also where a batch takes the end of one epoch and the beginning of the next."""
    sampler = EpisodeAwareSampler(dataset(lengths), batch_size=batch_size, seed=seed)
    total, epochs = sum(lengths), 3
    frames = np.concatenate([sampler.next_batch() for _ in range(-(-epochs * total // batch_size))])
    for epoch in range(epochs):
        assert sorted(frames[epoch * total : (epoch + 1) * total]) == list(range(total))
    assert sampler.epoch == (len(frames) - 1) // total


@given(lengths=datasets, share=st.integers(1, 5), world_size=st.integers(1, 4), seed=st.integers(0, 1000))
@settings(deadline=None)
def test_the_shares_of_the_processes_are_the_batch_of_one(lengths, share, world_size, seed):
    info, size = dataset(lengths), share * world_size
    whole = EpisodeAwareSampler(info, batch_size=size, seed=seed)
    ranks = [
        EpisodeAwareSampler(info, batch_size=size, seed=seed, rank=rank, world_size=world_size)
        for rank in range(world_size)
    ]
    for _ in range(4):
        shares = [sampler.next_batch() for sampler in ranks]
        assert {len(part) for part in shares} == {share}
        np.testing.assert_array_equal(np.stack(shares, axis=1).ravel(), whole.next_batch())
        assert len({tuple(sampler.state_dict().values()) for sampler in [*ranks, whole]}) == 1


@given(lengths=datasets, drop=st.integers(0, 4), data=st.data())
@settings(deadline=None)
def test_only_requested_frames_are_sampled(lengths, drop, data):
    info = dataset(lengths)
    chosen = data.draw(st.lists(st.sampled_from(range(len(lengths))), min_size=1, unique=True))
    expected = {f for e in chosen for f in range(info.episode_starts[e], info.episode_ends[e] - drop)}
    if not expected:
        with pytest.raises(ConfigError, match=rf"after dropping {drop} from the end of each. Choose more"):
            EpisodeAwareSampler(info, batch_size=1, seed=0, episodes=chosen, drop_last_frames=drop)
        return
    sampler = EpisodeAwareSampler(info, batch_size=1, seed=0, episodes=chosen, drop_last_frames=drop)
    assert sampler.num_frames == len(expected)
    assert {int(sampler.next_batch()[0]) for _ in expected} == expected


@given(lengths=datasets, taken=st.integers(0, 12), batch_size=st.integers(1, 7))
@settings(deadline=None)
def test_two_numbers_are_the_whole_state(lengths, taken, batch_size):
    def make():
        return EpisodeAwareSampler(dataset(lengths), batch_size=batch_size, seed=5)

    straight, resumed = make(), make()
    for _ in range(taken):
        straight.next_batch()
    resumed.load_state_dict(straight.state_dict())
    for _ in range(5):
        np.testing.assert_array_equal(resumed.next_batch(), straight.next_batch())


def test_seeds_and_epochs_have_orders_of_their_own():
    info = dataset([40])
    batches = [EpisodeAwareSampler(info, batch_size=40, seed=seed).next_batch() for seed in range(4)]
    sampler = EpisodeAwareSampler(info, batch_size=40, seed=0)
    batches += [sampler.next_batch() for _ in range(4)][1:]
    assert len({tuple(batch) for batch in batches}) == 7


@pytest.mark.parametrize(("batch_size", "world_size"), [(0, 1), (3, 2), (5, 4)])
def test_batches_that_do_not_divide_are_refused(batch_size, world_size):
    with pytest.raises(
        ConfigError, match=f"batch_size {batch_size} must be a positive multiple of {world_size} processes"
    ):
        EpisodeAwareSampler(dataset([9]), batch_size=batch_size, seed=0, world_size=world_size)

"""The replay buffer by hand."""

import pytest
import torch

from envs.errors import CheckpointError, ConfigError
from roboverse_learn.training.replay import ReplayBuffer, Transitions


def filled(steps, over, *, capacity=40, num_envs=2, horizon=3):
    """Steps count up from 0 in observation, action and reward; environment 1 is 100 higher."""
    buffer = ReplayBuffer(capacity, num_envs, 1, 1, torch.device("cpu"), horizon)
    for t in range(steps):
        value = torch.tensor([float(t), 100.0 + t])
        ends = torch.tensor([t in over, False])
        step = Transitions(value[:, None], value[:, None], value, ends.float(), value[:, None] + 0.5)
        buffer.add(step, ends)
    return buffer


def starts(buffer):
    return {int(value) for value in buffer.sequences(4000).rewards[0]}


def test_sequences_lie_within_one_episode():
    buffer = filled(10, over={4})
    assert starts(buffer) == {0, 1, 2, 5, 6, 7, *range(100, 108)}  # 3 and 4 would go beyond the end


def test_a_sequence_is_what_happened():
    batch = filled(10, over={4}).sequences(500)
    assert batch.observations.shape == (4, 500, 1) and batch.actions.shape == (3, 500, 1)
    first = batch.rewards[0]
    for k in range(3):
        torch.testing.assert_close(batch.rewards[k], first + k)
        torch.testing.assert_close(batch.actions[k, :, 0], first + k)
        torch.testing.assert_close(batch.observations[k + 1, :, 0], first + k + 0.5)
    torch.testing.assert_close(batch.observations[0, :, 0], first)
    assert not batch.terminated[:2].any()
    torch.testing.assert_close(batch.terminated[2], (first == 2).float())


def test_the_ring_forgets_the_oldest_steps_and_never_joins_ends():
    buffer = filled(25, over=set(), capacity=20)  # 10 steps of each
    assert len(buffer) == 20
    assert starts(buffer) == {*range(15, 23), *range(115, 123)}


def test_single_steps_are_drawn_of_all_that_is_there():
    batch = filled(5, over={2}, horizon=1).transitions(4000)
    assert {int(value) for value in batch.reward} == {*range(5), *range(100, 105)}
    torch.testing.assert_close(batch.next_observation, batch.observation + 0.5)
    assert {int(value) for value in batch.reward[batch.terminated > 0]} == {2}


def test_state_round_trip():
    buffer, other = filled(25, over={20}, capacity=20), filled(0, over=set(), capacity=20)
    tensors, numbers = buffer.state()
    other.load(tensors, numbers)
    torch.manual_seed(0)
    expected = buffer.sequences(50)
    torch.manual_seed(0)
    for mine, theirs in zip(other.sequences(50), expected, strict=True):
        assert mine.equal(theirs)
    with pytest.raises(CheckpointError, match=r"Go on with the same policy.num_envs"):
        filled(0, over=set(), capacity=30, num_envs=3).load(tensors, numbers)


def test_a_buffer_that_holds_no_sequence_is_an_error():
    with pytest.raises(ConfigError, match=r"policy.buffer_size=7 holds 3 step.s. of each of 2"):
        filled(0, over=set(), capacity=7)

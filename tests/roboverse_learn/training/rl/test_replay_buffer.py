"""The replay buffer by hand."""

import pytest
import torch

from envs.core.errors import CheckpointError, ConfigError
from roboverse_learn.training.rl.replay_buffer import ReplayBuffer, Transitions


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


def test_what_a_sequence_holds_of_the_next_episode_is_marked():
    buffer = filled(10, over={4})
    assert starts(buffer) == {*range(8), *range(100, 108)}
    batch = buffer.sequences(4000)
    for first, steps in ((2, 3), (3, 2), (4, 1), (5, 3), (104, 3)):
        row = (batch.rewards[0] == first).nonzero()[0, 0]
        assert batch.valid[:, row].tolist() == [1.0] * steps + [0.0] * (3 - steps)


def test_episode_ends_are_sampled_as_often_as_other_steps():
    torch.manual_seed(0)
    batch = filled(30, over={14}, capacity=80).sequences(28_000)  # 28 starts in each environment
    for place in range(3):
        counts = {t: int(((batch.rewards[place] == t) & (batch.valid[place] > 0)).sum()) for t in (10, 14)}
        assert all(420 < count < 580 for count in counts.values())  # 500 expected
        assert batch.terminated[place].sum() == counts[14]


def test_a_sequence_is_what_happened():
    batch = filled(10, over={4}).sequences(500)
    assert batch.observations.shape == (4, 500, 1) and batch.actions.shape == (3, 500, 1)
    first = batch.rewards[0]
    for k in range(3):
        torch.testing.assert_close(batch.rewards[k], first + k)
        torch.testing.assert_close(batch.actions[k, :, 0], first + k)
        torch.testing.assert_close(batch.observations[k + 1, :, 0], first + k + 0.5)
    torch.testing.assert_close(batch.observations[0, :, 0], first)
    torch.testing.assert_close(batch.terminated, (batch.rewards == 4).float())


def test_the_ring_forgets_the_oldest_steps_and_never_joins_ends():
    buffer = filled(25, over=set(), capacity=20)  # 10 steps of each
    assert len(buffer) == 20
    assert starts(buffer) == {*range(15, 23), *range(115, 123)}


def test_single_steps_are_sampled_from_the_whole_buffer():
    batch = filled(5, over={2}, horizon=1).returns(4000, 1, 0.9)
    assert {int(value) for value in batch.reward} == {*range(5), *range(100, 105)}
    torch.testing.assert_close(batch.next_observation, batch.observation + 0.5)
    torch.testing.assert_close(batch.discount, torch.where(batch.reward == 2, 0.0, 0.9))


def after(batch, first):
    """What the step ``first`` led to: its return, discount, and the step that it ends with."""
    row = (batch.observation[:, 0] == first).nonzero()[0, 0]
    return [float(value[row].squeeze()) for value in (batch.reward, batch.discount, batch.next_observation)]


def test_returns_of_three_steps_stop_at_the_end_of_an_episode():
    batch = filled(8, over={3}, horizon=1).returns(4000, 3, 0.5)
    assert after(batch, 0) == [0 + 0.5 * 1 + 0.25 * 2, 0.125, 2.5]
    assert after(batch, 1) == [1 + 0.5 * 2 + 0.25 * 3, 0.0, 3.5]
    assert after(batch, 2) == [2 + 0.5 * 3, 0.0, 3.5]
    assert after(batch, 103) == [103 + 0.5 * 104 + 0.25 * 105, 0.125, 105.5]
    assert after(batch, 7) == [7, 0.5, 7.5]  # nothing is known of what came after it


def test_returns_go_around_the_ring_but_not_into_what_was_overwritten():
    batch = filled(13, over=set(), capacity=20, horizon=1).returns(4000, 3, 0.5)
    assert {int(value) for value in batch.observation[:, 0]} == {*range(3, 13), *range(103, 113)}
    assert after(batch, 9) == [9 + 0.5 * 10 + 0.25 * 11, 0.125, 11.5]
    assert after(batch, 11) == [11 + 0.5 * 12, 0.25, 12.5]
    assert after(batch, 12) == [12, 0.5, 12.5]


def test_truncated_episode_bootstraps_from_its_last_observation():
    buffer = ReplayBuffer(20, 1, 1, 1, torch.device("cpu"))
    for t in range(4):
        value, cut_off = torch.tensor([float(t)]), torch.tensor([t == 1])
        step = Transitions(value[:, None], value[:, None], value, torch.zeros(1), value[:, None] + 0.5)
        buffer.add(step, cut_off)
    assert after(buffer.returns(500, 3, 0.5), 0) == [0.5, 0.25, 1.5]


def test_state_round_trip():
    buffer, other = filled(25, over={20}, capacity=20), filled(0, over=set(), capacity=20)
    tensors, numbers = buffer.state()
    other.load(tensors, numbers)
    torch.manual_seed(0)
    expected = buffer.sequences(50)
    torch.manual_seed(0)
    for mine, theirs in zip(other.sequences(50), expected, strict=True):
        assert mine.equal(theirs)
    with pytest.raises(CheckpointError, match=r"Resume with the same policy.num_envs"):
        filled(0, over=set(), capacity=30, num_envs=3).load(tensors, numbers)


def test_a_buffer_that_holds_no_sequence_is_an_error():
    with pytest.raises(ConfigError, match=r"policy.buffer_size=7 holds 3 step.s. of each of 2"):
        filled(0, over=set(), capacity=7)

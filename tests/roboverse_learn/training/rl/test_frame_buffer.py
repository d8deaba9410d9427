"""The replay buffer of images by hand: steps show their number, a frame of 1 × 1 pixel each."""

import pytest
import torch

from envs.core.errors import CheckpointError, ConfigError
from roboverse_learn.training.rl.frame_buffer import FrameReplay
from roboverse_learn.training.rl.replay_buffer import Transitions

CPU = torch.device("cpu")


def buffer(*, capacity=40, num_envs=2, horizon=3, num_frames=3):
    return FrameReplay(capacity, num_envs, (1, 1, 1), num_frames, 1, CPU, horizon)


class Story:
    """Environments whose frames count up; the second one's are 40 higher, and so on."""

    def __init__(self, replay):
        self.replay, self.time = replay, 0
        n = replay.num_envs
        self.stacks = [[40 * i] * replay.num_frames for i in range(n)]
        self.steps = [[] for _ in range(n)]  # (stack, action, stack after it, over)
        self.frames = [40 * i for i in range(n)]

    def step(self, ends=()):
        n, before = self.replay.num_envs, self.stacks
        for i in range(n):
            self.frames[i] += 1
        after = [[*stack[1:], self.frames[i]] for i, stack in enumerate(before)]
        action, over = float(self.time), [i in ends for i in range(n)]
        self.replay.add(
            Transitions(
                image(before), torch.full((n, 1), action), torch.full((n,), action),
                torch.tensor(over).float(), image(after),
            ),
            torch.tensor(over),
        )  # fmt: skip
        for i in range(n):
            self.steps[i].append((before[i], action, after[i], over[i]))
            if over[i]:
                self.frames[i] += 1
                after[i] = [self.frames[i]] * self.replay.num_frames
        self.stacks, self.time = after, self.time + 1


def image(stacks):
    return torch.tensor(stacks, dtype=torch.uint8)[..., None, None]


def seen(batch):
    """Per sequence: stacks (H + 1, F), actions (H), and which steps are valid."""
    stacks = batch.observations[..., 0, 0].permute(1, 0, 2).tolist()
    return list(zip(stacks, batch.actions[..., 0].T.tolist(), batch.valid.T.tolist(), strict=True))


def test_the_rows_of_two_steps_and_the_next_episode():
    replay = buffer(num_envs=1, capacity=10, horizon=2)
    story = Story(replay)
    story.step()
    story.step(ends={0})
    story.step()
    row = {key: value[:5, 0].flatten().tolist() for key, value in replay.storage.items()}
    assert row["frame"] == [0, 1, 2, 3, 4]  # every frame once: 0, 1, 2 of the first episode, 3, 4 of the next
    assert row["age"] == [0, 1, 2, 0, 1]
    assert row["end"] == [False, False, True, False, True]  # the newest frame ends it until more is known
    assert [row["action"][i] for i in (0, 1, 3)] == [0.0, 1.0, 2.0]
    assert {key: int(value) for key, value in replay.present.items()} == {"next": 4, "filled": 4, "now": 1}
    assert len(replay) == 3


def test_a_stack_does_not_reach_into_the_episode_before():
    replay = buffer(num_envs=1, capacity=20, horizon=2)
    story = Story(replay)
    for ends in ((), (), {0}, (), ()):
        story.step(ends)
    found = {
        actions[0]: (stacks, valid) for stacks, actions, valid in seen(replay.sequences(400)) if valid[0]
    }
    assert found[0.0] == ([[0, 0, 0], [0, 0, 1], [0, 1, 2]], [1, 1])
    assert found[1.0] == ([[0, 0, 1], [0, 1, 2], [1, 2, 3]], [1, 1])
    assert found[2.0][0][:2] == [[0, 1, 2], [1, 2, 3]] and found[2.0][1] == [1, 0]
    assert found[3.0] == ([[4, 4, 4], [4, 4, 5], [4, 5, 6]], [1, 1])


@pytest.mark.parametrize("num_envs", [1, 2, 5])
@pytest.mark.parametrize("steps", [5, 23])
def test_sampled_steps_are_valid_and_cover_the_buffer(num_envs, steps):
    torch.manual_seed(0)
    replay = buffer(num_envs=num_envs, capacity=14 * num_envs)
    story = Story(replay)
    for t in range(steps):
        story.step({i for i in range(num_envs) if (t + i) % (4 + i) == 3})
    known = {(step[0][-1] // 40, step[1]): step for own in story.steps for step in own}
    drawn = set()
    for stacks, actions, valid in seen(replay.sequences(4000)):
        assert valid == sorted(valid, reverse=True)
        for h in range(int(sum(valid))):
            key = (stacks[h][-1] // 40, actions[h])
            before, _, after, over = known[key]
            assert (stacks[h], stacks[h + 1]) == (before, after)
            assert not over or not any(valid[h + 1 :])
            drawn.add(key)
    ages = [key[1] for key in drawn]
    assert max(ages) >= steps - 2 and min(ages) <= max(0, steps - 8)
    assert {key[0] for key in drawn} == set(range(num_envs))
    if steps == 5:
        assert {key for key in known if key[1] <= steps - 3} <= drawn  # from which a sequence has happened


def test_each_step_is_sampled_equally_often():
    torch.manual_seed(0)
    replay = buffer(num_envs=1, capacity=40)
    story = Story(replay)
    for t in range(28):
        story.step({0} if t == 14 else ())
    batch = replay.sequences(27_000)  # 28 steps and an end: 27 beginnings of three rows
    for action in (4.0, 14.0, 15.0, 20.0):
        count = int(((batch.actions[0, :, 0] == action) & (batch.valid[0] > 0)).sum())
        assert 880 < count < 1120  # 1000 expected


@pytest.mark.parametrize("steps", [6, 30])
def test_state_round_trip(steps):
    replay, other = buffer(), buffer()
    story = Story(replay)
    for t in range(steps):
        story.step({t % 2} if t % 3 == 2 else ())
    tensors, numbers = replay.state()
    assert steps > 20 or len(tensors["frame"]) < replay.length  # what was never written is not saved
    other.load(tensors, numbers)
    story.step()
    Story.step(twin := Story(other))
    assert twin.time == 1 and len(other) == len(replay)
    other.load(*replay.state())
    torch.manual_seed(0)
    expected = replay.sequences(50)
    torch.manual_seed(0)
    for mine, theirs in zip(other.sequences(50), expected, strict=True):
        assert mine.equal(theirs)
    with pytest.raises(CheckpointError, match=r"Resume with the same policy.num_envs"):
        buffer(num_envs=3).load(tensors, numbers)


def test_what_cannot_be_kept_is_an_error():
    with pytest.raises(
        ConfigError, match=r"policy.buffer_size=12 holds 6 row.s. of each of 2.*Take 14 at least"
    ):
        buffer(capacity=12)
    with pytest.raises(ConfigError, match=r"takes 12288000.0 GB of images.*a step takes 12 kB"):
        FrameReplay(10**12, 1, (3, 64, 64), 3, 1, CPU, 3)

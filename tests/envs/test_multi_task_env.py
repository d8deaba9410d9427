"""Several tasks side by side: padding, statistics, and that none has an influence on another."""

import math

import pytest
import torch

from envs.core.errors import ConfigError
from envs.multi_task_env import MultiTaskEnv
from tests.roboverse_learn.training.point_mass import STEPS, Mirrored, PointMass


def make(**more):
    return MultiTaskEnv({"line": PointMass(2), "mirror": Mirrored(3), **more})


def test_environments_lie_side_by_side_and_observations_are_padded_with_zeros():
    env = make()
    assert (env.num_envs, env.observation_size, env.action_size) == (5, 3, 2)
    assert env.max_episode_steps == STEPS
    assert env.task_ids.tolist() == [0, 0, 1, 1, 1]
    env.reset()
    step = env.step(torch.ones(5, 2))
    for seen in (step.obs, step.final_obs):
        assert seen.shape == (5, 3)
        assert not seen[:2, 2].any() and seen[2:].all()
    assert step.reward.shape == step.terminated.shape == step.truncated.shape == step.success.shape == (5,)


def test_entries_of_an_action_that_a_task_lacks_have_no_influence():
    seen = []
    for padding in (0.0, 0.7, math.nan):
        env = make()
        env.seed(1)
        env.reset()
        action = torch.full((5, 2), 0.5)
        action[:2, 1] = padding
        seen.append(env.step(action).obs)
    assert seen[0].equal(seen[1]) and seen[0].equal(seen[2])


def test_random_numbers_of_a_task_do_not_depend_on_other_tasks():
    alone, beside = MultiTaskEnv({"line": PointMass(2)}), make()
    starts = []
    for env in (alone, beside):
        env.seed(3)
        starts.append(env.reset()[:2, 0])
    assert starts[0].equal(starts[1])
    twins = MultiTaskEnv({"a": PointMass(2), "b": PointMass(2)})
    twins.seed(3)
    first, second = twins.reset().split(2)
    assert not first.equal(second)


def test_some_can_be_reset_alone():
    env = make()
    env.reset()
    before = env.step(torch.ones(5, 2)).obs
    after = env.reset(torch.tensor([False, True, True, False, False]))
    unchanged = [0, 3, 4]
    assert after[unchanged].equal(before[unchanged])
    assert not after[1, 1] and not after[2, 1]


def test_statistics_are_of_each_task_and_of_all_episodes_together():
    env = make()
    env.reset()
    assert env.pop_statistics().episodes == 0 and env.pop_statistics().means() == {}
    env.envs["line"].ended = [(2.0, 10.0)]
    popped = env.pop_statistics()
    assert popped.means() == {
        "episode_return": 2.0, "episode_length": 10.0, "success_rate": 1.0,
        "episode_return/line": 2.0, "episode_length/line": 10.0, "success_rate/line": 1.0,
    }  # fmt: skip
    env.envs["line"].ended, env.envs["mirror"].ended = [(2.0, 10.0)], [(5.0, 20.0), (8.0, 30.0)]
    popped = env.pop_statistics()
    assert (popped.episodes, popped.episode_return, popped.length) == (3, 5.0, 20.0)
    assert (popped.by_task["line"].episode_return, popped.by_task["mirror"].episode_return) == (
        2.0,
        6.5,
    )
    assert env.pop_statistics().episodes == 0


def test_it_resumes_where_it_was():
    env = make()
    env.seed(1)
    env.reset()
    env.step(torch.ones(5, 2))
    # As from a checkpoint, in which all numbers of the env are one tensor.
    state, random = (
        {key: value.clone() for key, value in env.state_dict().items()},
        env.random_state().clone(),
    )
    expected = [env.step(torch.ones(5, 2)).obs for _ in range(STEPS)]
    other = make()
    seen = other.load_state_dict(state)
    other.set_random_state(random)
    assert seen.shape == (5, 3) and not seen[:2, 2].any()
    assert all(other.step(torch.ones(5, 2)).obs.equal(each) for each in expected)


def test_closing_it_closes_all_and_no_task_is_an_error():
    env = make()
    env.close()
    assert all(each.closed for each in env.envs.values())
    with pytest.raises(ConfigError, match="needs at least one task"):
        MultiTaskEnv({})

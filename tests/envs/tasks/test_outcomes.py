"""How episodes end: success, failure, the horizon, and a return that counts as success."""

import numpy as np
import pytest
import torch

import envs
from envs.core.errors import ConfigError, UnknownNameError
from envs.tasks.outcomes import outcome, solved
from envs.tasks.pick_cube import PickCube

ROWS = 4
HIGH_M = 0.3


class Judged(PickCube):
    """The cube right of the middle is a success, left of it a failure where it is high up."""

    name = "Judged"

    def success(self, state):
        return state.objects["cube"].pos[:, 0] > 0.0

    def failure(self, state):
        return state.objects["cube"].pos[:, 2] > HIGH_M

    def reward(self, state):
        return state.objects["cube"].pos[:, 2]


@pytest.fixture
def state():
    """Success, success that is a failure too, failure, neither."""
    state = PickCube().initial_state([np.random.default_rng(i) for i in range(ROWS)])
    state.objects["cube"].pos[:, 0] = torch.tensor([0.1, 0.1, -0.1, -0.1])
    state.objects["cube"].pos[:, 2] = torch.tensor([0.125, 0.5, 0.5, 0.125])
    return state


def test_success_ends_an_episode_with_reward_one_and_failure_only_ends_it(state):
    reward, terminated, success = outcome(Judged(), state)
    assert reward.tolist() == [1.0, 1.0, 0.5, 0.125]
    assert terminated.tolist() == [True, True, True, False]
    assert success.tolist() == [True, True, False, False]


def test_task_that_continues_after_success_keeps_its_reward_and_ends_by_failure(state, monkeypatch):
    monkeypatch.setattr(Judged, "ends_on_success", False)
    reward, terminated, success = outcome(Judged(), state)
    assert reward.tolist() == [0.125, 0.5, 0.5, 0.125]
    assert terminated.tolist() == [False, False, True, False]
    assert success.tolist() == [True, True, False, False]


def test_nothing_is_a_failure_by_default(state):
    assert not PickCube().failure(state).any()


def test_a_return_is_judged_once_the_episode_is_over(monkeypatch):
    success, over = torch.zeros(3, dtype=torch.bool), torch.tensor([True, True, False])
    returns = torch.tensor([5.0, 4.9, 9.0])
    assert not solved(PickCube(), success, over, returns).any()
    monkeypatch.setattr(PickCube, "success_return", 5.0)
    assert solved(PickCube(), success, over, returns).tolist() == [True, False, False]


def played(env, steps):
    hold = env.get_states().robots["franka"].joint_pos.numpy()
    return [env.step(hold) for _ in range(steps)]


@pytest.mark.slow
def test_an_env_counts_the_return_and_says_at_the_end_whether_it_was_enough(monkeypatch):
    monkeypatch.setattr(
        PickCube, "success", lambda self, state: torch.zeros(len(state.objects["cube"].pos)) > 1
    )
    monkeypatch.setattr(PickCube, "reward", lambda self, state: state.objects["cube"].pos[:, 0] * 0.0 + 2.0)
    monkeypatch.setattr(PickCube, "max_episode_steps", 3)
    monkeypatch.setattr(PickCube, "ends_on_success", False)
    for bar, enough in ((6.0, True), (6.5, False)):
        monkeypatch.setattr(PickCube, "success_return", bar)
        env = envs.make_vec("PickCube", 2, split="train", observation="state")
        env.reset(seed=0)
        steps = played(env, 3)
        assert [step[3].all() for step in steps] == [False, False, True]
        assert [step[4]["is_success"].any() for step in steps] == [False, False, enough]
        assert env.returns.tolist() == [6.0, 6.0]
        played(env, 1)  # restarts
        assert env.returns.tolist() == [0.0, 0.0]
        env.close()


def test_failure_terminates_without_success(monkeypatch):
    monkeypatch.setattr(PickCube, "failure", lambda self, state: state.objects["cube"].pos[:, 2] < HIGH_M)
    env = envs.RoboVerseEnv("PickCube", split="train", observation="state")
    env.reset(seed=0)
    _, reward, terminated, truncated, info = env.step(env.action_space.low)
    assert (terminated, truncated, info["is_success"]) == (True, False, False)
    assert 0.0 <= reward < 1.0
    env.close()


def test_the_actions_may_be_those_of_an_agent(monkeypatch):
    seen = []
    monkeypatch.setattr(PickCube, "rl_controller", property(lambda self: seen.append(1) or self.controller))
    envs.make_vec("PickCube", 1, split="train", observation="state", actions="rl").close()
    assert seen
    with pytest.raises(UnknownNameError, match=r"Unknown kind of actions 'rll'.*Did you mean 'rl'"):
        envs.make_vec("PickCube", 1, split="train", actions="rll")


def test_a_task_without_an_expert_says_how_it_is_learned(state, monkeypatch):
    monkeypatch.delattr(PickCube, "expert")
    with pytest.raises(ConfigError, match=r"PickCube has no scripted expert. Use .*policy=ppo"):
        PickCube().expert(state, np.random.default_rng(0))

"""Recorded episodes: what is written down is what happened, and can be played again."""

import numpy as np
import pytest
import torch

import envs
from envs.experts.rollout import TAIL_STEPS, ExpertRunner, rollout
from envs.state import State

NUM_ENVS = 2


@pytest.fixture(scope="module")
def env():
    env = envs.make_vec("PickCube", NUM_ENVS, split="train", level=1, image_size=32)
    yield env
    env.close()


@pytest.fixture(scope="module")
def episodes(env):
    return env.split_indices[:3].tolist()


@pytest.fixture(scope="module")
def rollouts(env, episodes):
    return list(rollout(env, episodes))


def raw_row(recorded, step):
    return State.unflatten({key: torch.from_numpy(value[[step]]) for key, value in recorded.raw.items()})


def test_they_come_in_order_though_there_are_fewer_environments(rollouts, episodes):
    assert [recorded.episode for recorded in rollouts] == episodes


def test_lengths_and_types_agree(env, rollouts):
    for recorded in rollouts:
        steps = len(recorded.actions)
        assert recorded.actions.shape == (steps, 9)
        assert recorded.observation_state.shape == (steps, 9)
        assert recorded.rewards.shape == (steps,)
        assert recorded.images["front"].shape == (steps, 32, 32, 3)
        assert {
            array.dtype for array in (recorded.actions, recorded.observation_state, recorded.rewards)
        } == {np.dtype(np.float32)}
        assert recorded.images["front"].dtype == np.uint8
        assert all(len(value) == steps + 1 for value in recorded.raw.values())
        assert all(value.dtype == np.float64 for value in recorded.raw.values())


def test_recording_goes_on_for_a_few_steps_after_success(rollouts):
    for recorded in rollouts:
        assert recorded.success
        first = int(np.argmax(recorded.rewards == 1.0))
        assert len(recorded.rewards) == first + 1 + TAIL_STEPS


def test_what_a_policy_sees_is_the_state_before_the_step(rollouts):
    for recorded in rollouts:
        joints = recorded.raw["robots/franka/joint_pos"]
        np.testing.assert_array_equal(recorded.observation_state, joints[:-1].astype(np.float32))


def test_actions_are_what_the_simulator_was_told(rollouts):
    """The target that each later state carries is the action of the step before it."""
    for recorded in rollouts:
        targets = recorded.raw["robots/franka/joint_target"][1:]
        np.testing.assert_allclose(targets, recorded.actions, atol=1e-6)


def test_actions_replay_to_every_raw_row_to_the_bit(env, rollouts):
    """From the first raw row alone, through the handler: no hidden state is needed."""
    for recorded in rollouts:
        env.reset_envs([0], [recorded.episode])
        env.handler.set_states(raw_row(recorded, 0), [0])
        for step, action in enumerate(recorded.actions):
            env.step_envs([0], action[None])
            for key, value in env.get_states([0]).flatten().items():
                np.testing.assert_array_equal(value[0], recorded.raw[key][step + 1], err_msg=f"{key} {step}")


@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_a_raw_row_draws_the_recorded_picture(env, rollouts, share):
    for recorded in rollouts:
        step = int(share * len(recorded.actions))
        env.reset_envs([1], [recorded.episode])
        env.handler.set_states(raw_row(recorded, step), [1])
        picture = env.observe([1])["observation.images.front"][0]
        np.testing.assert_array_equal(picture, recorded.images["front"][step])


def test_an_episode_is_recorded_alike_alone(env, episodes, rollouts):
    alone = next(ExpertRunner(env).rollout(episodes[1:2]))
    assert alone.initial_state_hash == rollouts[1].initial_state_hash
    assert alone.instruction == rollouts[1].instruction
    np.testing.assert_array_equal(alone.actions, rollouts[1].actions)
    np.testing.assert_array_equal(alone.images["front"], rollouts[1].images["front"])


def test_pictures_without_cameras_are_none():
    env = envs.make_vec("PickCube", 1, split="train", observation="state")
    recorded = next(rollout(env, env.split_indices[:1].tolist()))
    env.close()
    assert recorded.images == {}
    assert recorded.success

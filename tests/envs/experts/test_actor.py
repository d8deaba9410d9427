"""Recorded episodes of the expert: what is recorded is what happened, on any schedule."""

import numpy as np
import pytest
import torch

import envs
from envs.experts.actor import expert_episodes
from envs.rollout import Episode
from envs.state import State
from envs.tasks.pick_cube import PickCube
from envs.tasks.plan_following import TAIL_STEPS, plan_all, plan_each
from envs.tasks.waypoint_planner import WaypointPlanner


class OneByOne:
    """A planner that cannot plan in batches."""

    def __init__(self, planner):
        self.plan = planner.plan


@pytest.fixture(scope="module")
def env():
    env = envs.make_vec("PickCube", 2, split="train", level=1, image_size=32)
    yield env
    env.close()


@pytest.fixture(scope="module")
def warp_env():
    env = envs.make_vec(
        "PickCube", 2, split="train", level=1, simulator="mujoco_warp", cameras=["front"], image_size=16
    )
    yield env
    env.close()


@pytest.fixture(scope="module")
def episodes(env):
    return env.split_indices[:5].tolist()


@pytest.fixture(scope="module")
def recorded(env, episodes):
    """Five episodes in two environments."""
    return list(expert_episodes(env, episodes))


def raw_row(episode: Episode, step: int) -> State:
    return State.unflatten({key: torch.from_numpy(value[[step]]) for key, value in episode.raw.items()})


def assert_bit_identical(ours: Episode, theirs: Episode):
    for key in ("episode", "success", "instruction", "initial_state_hash", "episode_return", "solved_at"):
        assert getattr(ours, key) == getattr(theirs, key), key
    for key in ("actions", "rewards", "successes", "observation_state"):
        one, other = getattr(ours, key), getattr(theirs, key)
        assert one.dtype == other.dtype, key
        np.testing.assert_array_equal(one, other, err_msg=key)
    for one, other in ((ours.raw, theirs.raw), (ours.images, theirs.images)):
        assert one.keys() == other.keys()
        for key, values in other.items():
            assert one[key].dtype == values.dtype, key
            np.testing.assert_array_equal(one[key], values, err_msg=key)


@pytest.mark.slow
def test_episodes_come_in_order_though_they_end_out_of_order(recorded, episodes):
    assert [each.episode for each in recorded] == episodes


@pytest.mark.slow
def test_lengths_and_types_agree(recorded):
    for each in recorded:
        steps = each.length
        assert each.actions.shape == each.observation_state.shape == (steps, 9)
        assert each.rewards.shape == each.successes.shape == (steps,)
        assert each.images["front"].shape == (steps, 32, 32, 3)
        assert {each.actions.dtype, each.observation_state.dtype, each.rewards.dtype} == {np.dtype("f4")}
        assert each.images["front"].dtype == np.uint8
        assert {(len(value), value.dtype) for value in each.raw.values()} == {(steps + 1, np.dtype("f8"))}
        assert each.states.num_envs == steps + 1


@pytest.mark.slow
def test_recording_continues_a_few_steps_after_success(recorded):
    for each in recorded:
        assert each.success
        assert each.solved_at == 1 + int(np.argmax(each.rewards == 1.0)) == 1 + int(np.argmax(each.successes))
        assert each.length == each.solved_at + TAIL_STEPS


@pytest.mark.slow
def test_observed_joints_are_those_before_the_step(recorded):
    for each in recorded:
        joints = each.raw["robots/franka/joint_pos"]
        np.testing.assert_array_equal(each.observation_state, joints[:-1].astype(np.float32))


@pytest.mark.slow
def test_actions_are_the_joint_targets_of_the_simulator(recorded):
    for each in recorded:
        targets = each.raw["robots/franka/joint_target"][1:]
        np.testing.assert_allclose(targets, each.actions, atol=1e-6)


@pytest.mark.slow
def test_actions_from_the_first_state_lead_to_every_recorded_state_bit_identically(env, recorded):
    for each in recorded[:3]:
        env.reset_envs([0], [each.episode])
        env.handler.set_states(raw_row(each, 0), [0])
        for step, action in enumerate(each.actions):
            env.step_envs([0], action[None])
            for key, value in env.get_states([0]).flatten().items():
                np.testing.assert_array_equal(value[0], each.raw[key][step + 1], err_msg=f"{key} {step}")


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_recorded_state_renders_the_recorded_image(env, recorded, share):
    for each in recorded[:3]:
        step = int(share * each.length)
        env.reset_envs([1], [each.episode])
        env.handler.set_states(raw_row(each, step), [1])
        image = env.observe([1])["observation.images.front"][0]
        np.testing.assert_array_equal(image, each.images["front"][step])


@pytest.mark.slow
@pytest.mark.parametrize("num_envs", [1, 3])
def test_episodes_do_not_depend_on_the_number_of_envs(recorded, episodes, num_envs):
    env = envs.make_vec("PickCube", num_envs, split="train", level=1, image_size=32)
    for ours, theirs in zip(expert_episodes(env, episodes), recorded, strict=True):
        assert_bit_identical(ours, theirs)
    env.close()


@pytest.mark.slow
def test_only_steps_are_recorded_by_default(env, recorded):
    (episode,) = expert_episodes(env, [recorded[0].episode], record=())
    assert episode.images == {}
    np.testing.assert_array_equal(episode.actions, recorded[0].actions)


def test_episode_ends_at_the_limit_of_steps_or_when_the_expert_gives_up(env, episodes, monkeypatch):
    monkeypatch.setattr(env, "max_episode_steps", 7)
    (episode,) = expert_episodes(env, episodes[:1])
    assert not episode.success and episode.length == 7
    monkeypatch.setattr(PickCube, "expert", lambda *_: [])
    (episode,) = expert_episodes(env, episodes[:1])
    assert not episode.success and episode.length == 0
    assert episode.images == {} and len(episode.raw["objects/cube/pos"]) == 1


@pytest.mark.slow
def test_waves_are_bit_identical_to_one_episode_at_a_time(warp_env, episodes, monkeypatch):
    """Three episodes in two environments: two waves, images included."""
    planner = OneByOne(warp_env.task.planner)
    waves = list(expert_episodes(warp_env, episodes[:3], planner))
    monkeypatch.setattr(warp_env.handler, "steps_together", False)
    single = list(expert_episodes(warp_env, episodes[:3], planner))
    assert [each.episode for each in waves] == episodes[:3]
    for ours, theirs in zip(waves, single, strict=True):
        assert ours.success
        assert_bit_identical(ours, theirs)


@pytest.mark.slow
def test_plans_made_together_succeed_like_single_ones(warp_env, episodes, monkeypatch):
    """They differ by rounding."""
    (found,) = expert_episodes(warp_env, episodes[:1])
    monkeypatch.setattr(warp_env.handler, "steps_together", False)
    (expected,) = expert_episodes(warp_env, episodes[:1])
    assert found.success and found.length == expected.length
    np.testing.assert_allclose(found.actions, expected.actions, atol=1e-3)


def test_a_batch_of_plans_has_a_plan_for_each():
    task = PickCube()
    planner = task.planner
    states = task.initial_state([np.random.default_rng(seed) for seed in range(3)])

    def rngs():
        return [np.random.default_rng(10 + row) for row in range(3)]

    for ours, theirs in zip(
        plan_all(planner, states, rngs()), plan_all(OneByOne(planner), states, rngs()), strict=True
    ):
        assert ours.dtype == theirs.dtype == np.float32
        assert ours.shape == theirs.shape
        np.testing.assert_allclose(ours, theirs, atol=1e-3)


def test_plans_made_together_are_those_of_each_state_alone():
    """Bit-identical, though they end at other steps, and one of them gives up."""
    task = PickCube()
    states = task.initial_state([np.random.default_rng(seed) for seed in range(4)])
    planner = WaypointPlanner(
        task.scenario, lambda state, rng: [] if rng.uniform() < 0.3 else task.expert(state, rng)
    )

    def rngs():
        return [np.random.default_rng(20 + row) for row in range(4)]

    together = plan_each(planner, states, rngs())
    alone = [planner.plan(states.select([row]), rng) for row, rng in enumerate(rngs())]
    assert [len(plan) for plan in together].count(0) == 1
    assert len({len(plan) for plan in together}) > 2
    for ours, theirs in zip(together, alone, strict=True):
        np.testing.assert_array_equal(ours, theirs)

"""The batched env: episodes by index, laziness, Gymnasium's vector interface."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest

import envs
from envs.core.errors import ConfigError, UnknownNameError
from envs.randomization import channel_rng

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def pixels():
    env = envs.make_vec("PickCube", 2, split="train", image_size=32)
    yield env
    env.close()


def counting_renders(env, monkeypatch):
    calls = []
    original = env.handler.render_jobs

    def counted(jobs, *args):
        calls.append(len(jobs))
        return original(jobs, *args)

    monkeypatch.setattr(env.handler, "render_jobs", counted)
    return calls


def test_twenty_steps_and_one_look_render_once(pixels, monkeypatch):
    calls = counting_renders(pixels, monkeypatch)
    pixels.reset(seed=0)
    action = pixels.handler.get_states().robots["franka"].joint_pos.numpy()
    for _ in range(20):
        observation, *_ = pixels.step(action)
    assert calls == []
    assert observation["pixels"]["front"].shape == (2, 32, 32, 3)
    observation["pixels"]["front"]
    assert calls == [2]


def test_a_late_look_shows_the_moment_of_the_observation(pixels):
    observation, _ = pixels.reset(seed=3)
    now = pixels.observe()["observation.images.front"]
    low = np.repeat(pixels.single_action_space.low[None], 2, 0)
    for _ in range(10):
        pixels.step(low)
    np.testing.assert_array_equal(observation["pixels"]["front"], now)
    assert (pixels.observe()["observation.images.front"] != now).any()


def test_lazy_pixels_are_a_plain_dict(pixels):
    observation, _ = pixels.reset(seed=3)
    lazy = observation["pixels"]
    assert list(lazy) == ["front"]
    assert not lazy.drawn
    clone = copy.deepcopy(lazy)
    assert clone.drawn
    assert lazy.drawn
    again = pickle.loads(pickle.dumps(lazy))
    np.testing.assert_array_equal(again["front"], clone["front"])
    assert pixels.observation_space.contains(observation)


@pytest.mark.parametrize("level", [pytest.param(0, marks=pytest.mark.long), 3])
def test_an_episode_is_the_same_for_any_number_of_environments(level):
    """States, images and hashes are bit-identical for 1, 4 and 16 environments."""
    results = []
    for num_envs in (1, 4, 16):
        env = envs.make_vec("PickCube", num_envs, split="test", level=level, image_size=32)
        episodes, seen = env.split_indices[:4], []
        for first in range(0, 4, min(num_envs, 4)):
            chunk = episodes[first : first + num_envs]
            ids = np.arange(len(chunk))
            env.reset_envs(ids, chunk)
            hashes = [env.initial_state_hash(i) for i in ids]
            for step in range(3):
                env.step_envs(ids, np.tile(env.single_action_space.low * 0.1 * step, (len(ids), 1)))
            observation = env.observe(ids)
            seen += [
                (
                    h,
                    observation["observation.state"][i].tobytes(),
                    observation["observation.images.front"][i].tobytes(),
                )
                for i, h in enumerate(hashes)
            ]
        results.append(seen)
        env.close()
    assert results[0] == results[1] == results[2]


def test_hashes_differ_between_episodes_and_appearances():
    def hashes(level):
        env = envs.make_vec("PickCube", 8, split="test", level=level, observation="state")
        env.reset_envs(range(8), env.split_indices[:8])
        out = [env.initial_state_hash(i) for i in range(8)]
        env.close()
        return out

    plain, dressed = hashes(0), hashes(1)
    assert len(set(plain)) == 8
    assert not set(plain) & set(dressed)


def test_the_size_of_the_image_is_no_part_of_an_episode():
    hashes = []
    for size in (16, 32):
        env = envs.make_vec("PickCube", 1, split="test", level=3, image_size=size)
        env.reset_envs([0], env.split_indices[:1])
        hashes.append(env.initial_state_hash(0))
        env.close()
    assert hashes[0] == hashes[1]


def test_the_other_splits_episodes_are_refused(pixels):
    test = envs.make_vec("PickCube", 1, split="test", observation="state")
    with pytest.raises(ConfigError, match="is not in the split 'train'"):
        pixels.reset_envs([0], test.split_indices[:1])
    test.close()


def test_rows_are_in_the_requested_order(pixels):
    pixels.reset_envs([1, 0], pixels.split_indices[[7, 8]])
    assert pixels.episodes.tolist() == [pixels.split_indices[8], pixels.split_indices[7]]
    forwards, backwards = pixels.observe([0, 1]), pixels.observe([1, 0])
    for key in forwards:
        np.testing.assert_array_equal(forwards[key], backwards[key][::-1])


def make(autoreset_mode):
    return envs.make_vec("PickCube", 2, split="train", observation="state", autoreset_mode=autoreset_mode)


def play_to_the_end(env):
    """Env 0 follows the expert, env 1 holds; returns every step's result until env 0 is done."""
    env.reset(options={"episodes": env.split_indices[:2]})
    plan = env.task.planner.plan(env.get_states([0]), channel_rng(0, "expert", int(env.episodes[0])))
    hold = env.handler.get_states([1]).robots["franka"].joint_pos.numpy()[0]
    for target in plan:
        result = env.step(np.stack([target, hold]).astype(np.float32))
        if result[2][0]:
            return result, hold
    raise AssertionError("the expert failed")


def test_next_step_autoreset_has_no_reward_and_restarts():
    env = make("NextStep")
    (_, reward, terminated, truncated, info), hold = play_to_the_end(env)
    assert (reward[0], terminated.tolist(), truncated.tolist()) == (1.0, [True, False], [False, False])
    assert info["success"].tolist() == info["is_success"].tolist() == [True, False]
    before = env.episodes.copy()
    observation, reward, terminated, _, _ = env.step(np.stack([hold, hold]))
    assert reward[0] == 0.0
    assert not terminated[0]
    assert env.episodes[0] != before[0]
    assert env.episodes[1] == before[1]
    assert env.elapsed_steps[0] == 0
    np.testing.assert_array_equal(observation["agent_pos"], env.observe()["observation.state"])
    env.close()


def test_same_step_autoreset_hands_over_the_final_observation():
    env = make("SameStep")
    (observation, _, terminated, _, info), _ = play_to_the_end(env)
    assert terminated[0]
    assert info["_final_obs"].tolist() == [True, False]
    final = info["final_obs"][0]["agent_pos"]
    assert not np.array_equal(final, observation["agent_pos"][0])
    assert info["final_info"]["is_success"][0]
    env.close()


def test_the_horizon_truncates_and_does_not_terminate():
    env = make("Disabled")
    env.reset(seed=0)
    hold = env.handler.get_states().robots["franka"].joint_pos.numpy()
    for step in range(env.task.max_episode_steps):
        _, _, terminated, truncated, _ = env.step(hold)
        assert truncated.all() == (step == env.task.max_episode_steps - 1)
        assert not terminated.any()
    env.close()


def test_gymnasium_makes_both_kinds():
    single = gymnasium.make("RoboVerse/PickCube-v0", image_size=32)
    observation, info = single.reset(seed=1)
    assert observation["pixels"]["front"].shape == (32, 32, 3)
    assert info["is_success"] is False
    assert single.render().shape == (32, 32, 3)
    single.close()
    batched = gymnasium.make_vec("RoboVerse/PickCube-v0", num_envs=3, observation="state")
    observation, _ = batched.reset(seed=1)
    assert observation["agent_pos"].shape == (3, 9)
    batched.close()


def test_settings_of_the_simulator_replace_the_scenarios():
    env = envs.make_vec("PickCube", 1, observation="state", simulator_settings={"impratio": 5.0})
    assert env.handler.physics_model.opt.impratio == 5.0
    env.close()
    with pytest.raises(
        UnknownNameError, match=r"Unknown setting of simulator=mujoco 'impratoi'. Did you mean 'impratio'"
    ):
        envs.make_vec("PickCube", 1, observation="state", simulator_settings={"impratoi": 5.0})


def test_mistakes_have_clear_messages():
    with pytest.raises(UnknownNameError, match=r"Unknown task 'PickKube'. Did you mean 'PickCube'"):
        envs.make_vec("PickKube", 1, split="train")
    with pytest.raises(UnknownNameError, match=r"Unknown simulator 'mujocco'. Did you mean 'mujoco'"):
        envs.make_vec("PickCube", 1, split="train", simulator="mujocco")
    with pytest.raises(UnknownNameError, match="Unknown renderer 'wrap'"):
        envs.make_vec("PickCube", 1, split="train", renderer="wrap")
    with pytest.raises(UnknownNameError, match="Unknown split 'tset'"):
        envs.make_vec("PickCube", 1, split="tset")
    with pytest.raises(ConfigError, match="num_envs must be at least 1, given 0"):
        envs.make_vec("PickCube", 0, split="train")
    with pytest.raises(UnknownNameError, match=r"Unknown variant of PickCube 'lft'.*Did you mean 'lift'"):
        envs.make_vec("PickCube", 1, split="train", task_kwargs={"variant": "lft"})


def test_cameras_are_chosen_by_name_and_change_no_episode():
    hashes = set()
    for cameras in (None, ["wrist"], ["wrist", "front"]):
        env = envs.make_vec("PickCube", 1, split="test", level=3, cameras=cameras, image_size=32)
        env.reset_envs([0], env.split_indices[:1])
        assert env.camera_names == tuple(cameras or ["front"])
        keys = [key for key in env.observe() if key.startswith("observation.images.")]
        assert keys == [f"observation.images.{name}" for name in env.camera_names]
        hashes.add(env.initial_state_hash(0))
        env.close()
    assert len(hashes) == 1
    with pytest.raises(UnknownNameError, match=r"Unknown camera 'wirst'.*Did you mean 'wrist'"):
        envs.make_vec("PickCube", 1, split="test", cameras=["wirst"])

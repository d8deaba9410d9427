"""The whole env on this simulator: the same episodes, spaces and images as on the default one."""

import numpy as np
import pytest

from envs.gym_env import make_vec


@pytest.fixture(scope="module")
def envs():
    both = [
        make_vec(
            "PickCube",
            2,
            split="test",
            level=1,
            simulator=name,
            cameras=["front"],
            image_size=48,
            num_threads=1,
        )
        for name in ("mujoco_warp", "mujoco")
    ]
    yield both
    for env in both:
        env.close()


@pytest.mark.slow
def test_an_episode_begins_and_looks_the_same(envs):
    ours, theirs = (env.reset(seed=3)[0] for env in envs)
    assert envs[0].initial_state_hash(0) == envs[1].initial_state_hash(0)
    np.testing.assert_allclose(ours["agent_pos"], theirs["agent_pos"], atol=1e-6)
    assert ours["agent_pos"].dtype == theirs["agent_pos"].dtype
    differs = np.abs(ours["pixels"]["front"].astype(int) - theirs["pixels"]["front"]).max(-1) > 2
    assert differs.mean() < 1e-2


def test_rewards_and_ends_agree(envs):
    for env in envs:
        env.reset(seed=4)
    rest = np.array(envs[0].scenario.robots[0].default_qpos, np.float32)
    for step in range(4):
        action = np.tile(rest + np.float32(0.02 * step), (2, 1))
        ours, theirs = (env.step(action) for env in envs)
        np.testing.assert_allclose(ours[0]["agent_pos"], theirs[0]["agent_pos"], atol=1e-4)
        np.testing.assert_allclose(ours[1], theirs[1], atol=1e-3)
        assert ours[1].dtype == theirs[1].dtype
        for mine, other in zip(ours[2:4], theirs[2:4], strict=True):
            np.testing.assert_array_equal(mine, other)


def test_pixels_that_are_read_late_show_their_own_moment(envs):
    ours = envs[0]
    observation, _ = ours.reset(seed=5)
    expected = ours.render()[0].copy()
    for _ in range(3):
        ours.step(np.tile(np.float32(0.2), (2, 9)))
    np.testing.assert_array_equal(observation["pixels"]["front"][0], expected)

"""Experts rolled out together are experts rolled out one by one."""

import numpy as np
import pytest

from envs.experts.batched_rollout import BatchedExpertRunner
from envs.experts.rollout import ExpertRunner, rollout
from envs.tasks.pick_cube import PickCube
from envs.tasks.plan_following import plan_all
from envs.tasks.waypoint_planner import WaypointPlanner
from envs.vector_env import RoboVerseVectorEnv


class OneByOne:
    """A planner that cannot plan in batches."""

    def __init__(self, planner):
        self.plan = planner.plan


@pytest.fixture(scope="module")
def env():
    env = RoboVerseVectorEnv(
        "PickCube", 2, split="train", level=1, simulator="mujoco_warp", cameras=["front"], image_size=16
    )
    yield env
    env.close()


def test_a_batch_of_experts_is_each_of_them_to_the_bit(env):
    """Three episodes in two environments: two waves, pictures included."""
    episodes = env.split_indices[:3].tolist()
    expected = list(ExpertRunner(env).rollout(episodes))
    found = list(BatchedExpertRunner(env, OneByOne(env.task.planner)).rollout(episodes))
    assert [one.episode for one in found] == episodes
    for ours, theirs in zip(found, expected, strict=True):
        assert ours.success == theirs.success is True
        assert (ours.instruction, ours.initial_state_hash) == (theirs.instruction, theirs.initial_state_hash)
        for key in ("actions", "rewards", "observation_state"):
            one, other = getattr(ours, key), getattr(theirs, key)
            assert one.dtype == other.dtype, key
            np.testing.assert_array_equal(one, other, err_msg=key)
        assert ours.raw.keys() == theirs.raw.keys()
        for key, values in theirs.raw.items():
            assert ours.raw[key].dtype == values.dtype == np.float64, key
            np.testing.assert_array_equal(ours.raw[key], values, err_msg=key)
        np.testing.assert_array_equal(ours.images["front"], theirs.images["front"])


def test_the_simulator_decides_how_experts_are_run(env):
    """Batched plans differ from single ones by rounding, and succeed as often."""
    (found,) = rollout(env, env.split_indices[:1].tolist())
    (expected,) = ExpertRunner(env).rollout(env.split_indices[:1].tolist())
    assert found.success
    assert len(found.actions) == len(expected.actions)
    np.testing.assert_allclose(found.actions, expected.actions, atol=1e-3)


def test_a_batch_of_plans_has_a_plan_for_each():
    task = PickCube()
    planner = WaypointPlanner(task.scenario, task.expert)
    states = task.initial_state([np.random.default_rng(seed) for seed in range(3)])

    def rngs():
        return [np.random.default_rng(10 + row) for row in range(3)]

    for ours, theirs in zip(
        plan_all(planner, states, rngs()), plan_all(OneByOne(planner), states, rngs()), strict=True
    ):
        assert ours.dtype == theirs.dtype == np.float32
        assert ours.shape == theirs.shape
        np.testing.assert_allclose(ours, theirs, atol=1e-3)

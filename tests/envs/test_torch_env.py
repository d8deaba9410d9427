"""The environment with tensors, for reinforcement learning."""

import math

import pytest
import torch

from envs.core.errors import ConfigError
from envs.spec import EnvSpec
from envs.tasks.pick_cube import PickCube

N = 3


def make(num_envs=N, simulator="mujoco", **options):
    return EnvSpec(simulator=simulator).make_torch(num_envs, **{"bank_size": 5, "num_threads": 1} | options)


@pytest.fixture(scope="module", params=["mujoco", "mujoco_warp"])
def env(request):
    env = make(simulator=request.param, max_episode_steps=4)
    yield env
    env.close()


@pytest.mark.slow
def test_shapes_and_types(env):
    assert (env.observation_size, env.action_size) == (9 + 9 + 9 + 19 + 1, 5)
    step = env.step(torch.zeros(N, 5))
    assert step.obs.shape == step.final_obs.shape == (N, env.observation_size)
    assert step.reward.shape == (N,)
    assert {step.obs.dtype, step.reward.dtype, step.final_obs.dtype} == {torch.float32}
    assert {step.terminated.dtype, step.truncated.dtype, step.success.dtype} == {torch.bool}


@pytest.mark.parametrize("env", ["mujoco_warp"], indirect=True)
def test_no_tensor_is_taken_for_an_array(env, monkeypatch):
    """NumPy reads a tensor of a CPU as it is and refuses one of a GPU, so none may be left to it."""

    def refuse(tensor, *_args, **_settings):
        raise TypeError("can't convert a tensor of a GPU")

    monkeypatch.setattr(torch.Tensor, "__array__", refuse)
    env.reset()
    for _ in range(env.max_episode_steps):
        step = env.step(torch.zeros(N, env.action_size))
    assert step.truncated.all() and env.elapsed_steps.tolist() == [0] * N


def test_finished_episode_restarts_and_returns_its_final_observation(env):
    env.reset()
    env.pop_statistics()
    for _ in range(3):
        step = env.step(torch.ones(N, 5))
        assert not (step.terminated | step.truncated).any()
        assert torch.equal(step.obs, step.final_obs)
    step = env.step(torch.ones(N, 5))
    assert step.truncated.all() and not step.terminated.any()
    assert not torch.isclose(step.obs[:, :3], step.final_obs[:, :3]).all()
    assert (step.obs[:, 9:18] == 0).all()  # it starts at rest
    assert env.elapsed_steps.tolist() == [0] * N
    statistics = env.pop_statistics()
    assert statistics.episodes == N and statistics.length == 4 and statistics.success_rate == 0
    assert 0 < statistics.episode_return < 4
    assert math.isnan(env.pop_statistics().episode_return)


def test_masked_environments_reset(env):
    env.reset()
    before = env.step(torch.ones(N, 5)).obs
    after = env.reset(torch.tensor([False, True, False]))
    torch.testing.assert_close(after[[0, 2]], before[[0, 2]])
    assert env.elapsed_steps.tolist() == [1, 0, 1]
    assert (after[1, 9:18] == 0).all()


def test_equal_seeds_give_equal_episodes(env):
    env.seed(3)
    first = env.reset()
    env.seed(3)
    assert torch.equal(env.reset(), first)
    env.seed(4)
    assert not torch.equal(env.reset(), first)


@pytest.mark.slow
def test_staggered_episodes_end_at_different_times():
    env = make(num_envs=16, max_episode_steps=8)
    env.stagger()
    assert len(set(env.elapsed_steps.tolist())) > 3
    assert ((env.elapsed_steps >= 0) & (env.elapsed_steps < 8)).all()
    env.close()


@pytest.mark.slow
def test_observations_and_rewards_match_the_numpy_environment():
    ours = make(num_envs=1, bank_size=1)
    theirs = EnvSpec().make(observation="full", actions="rl", num_threads=1)
    theirs.reset_envs([0], theirs.split_indices[:1])
    torch.testing.assert_close(ours.reset()[0].numpy(), theirs.observe()["observation.environment_state"][0])
    generator = torch.Generator().manual_seed(0)
    for _ in range(3):
        action = torch.rand(1, 5, generator=generator) * 2 - 1
        step, result = ours.step(action), theirs.step_envs([0], action.numpy())
        seen = theirs.observe()["observation.environment_state"]
        torch.testing.assert_close(step.obs.numpy(), seen)
        assert float(step.reward) == pytest.approx(float(result.reward[0]) - 1.0, abs=1e-6)
    ours.close()
    theirs.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("outcome", "shift", "reward"),
    [
        ({}, True, -0.75),
        ({"success": True}, True, 0.0),
        ({"failure": True}, True, -0.75 - 9),  # as if the nine steps that are left had no reward
        ({}, False, 0.25),
        ({"success": True}, False, 1.0),
        ({"failure": True}, False, 0.25),
    ],
)
def test_shifted_reward_of_success_and_failure(monkeypatch, outcome, shift, reward):
    env = make(2, max_episode_steps=10, shift_reward=shift)
    for name, value in ({"success": False, "failure": False, "reward": 0.25} | outcome).items():
        monkeypatch.setattr(PickCube, name, lambda _, state, v=value: torch.full((state.num_envs,), v))
    step = env.step(torch.zeros(2, 5))
    assert step.reward.tolist() == [reward] * 2
    assert step.terminated.tolist() == [bool(outcome)] * 2
    assert step.success.tolist() == [bool(outcome.get("success"))] * 2
    env.close()


def test_zero_environments_are_refused():
    with pytest.raises(ConfigError, match="num_envs must be at least 1, given 0"):
        make(num_envs=0)


def test_image_of_one_environment():
    env = make(num_envs=1)
    assert env.image().shape == (256, 256, 3)
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("simulator", ["mujoco", "mujoco_warp"])
def test_saved_state_resumes(simulator):
    env = make(simulator=simulator)
    env.step(torch.ones(N, 5))
    saved = {key: value.clone() for key, value in env.state_dict().items()}
    assert all("/" in key or key in ("elapsed_steps", "returns") for key in saved)
    seen = env.load_state_dict(saved)
    after = [env.step(torch.full((N, 5), 0.5)).obs for _ in range(3)]
    env.reset()
    assert env.load_state_dict(saved).equal(seen) and env.elapsed_steps.tolist() == [1] * N
    for expected in after:
        torch.testing.assert_close(env.step(torch.full((N, 5), 0.5)).obs, expected, atol=1e-5, rtol=1e-5)
    env.close()


@pytest.mark.slow
def test_substeps_make_physics_steps_longer():
    few, all_of_them = make(num_envs=1, substeps=5), make(num_envs=1)
    assert few.handler.scenario.physics.timestep_s == pytest.approx(0.01)
    step, other = few.step(torch.ones(1, 5)), all_of_them.step(torch.ones(1, 5))
    torch.testing.assert_close(step.obs[:, 18:27], other.obs[:, 18:27])  # targets
    torch.testing.assert_close(step.obs[:, :9], other.obs[:, :9], atol=0.05, rtol=0.0)
    with pytest.raises(ConfigError, match="A control step needs at least 1 physics step, given 0"):
        make(num_envs=1, substeps=0)

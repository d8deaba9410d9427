"""The batched env for agents that learn by reward."""

import math

import pytest
import torch

from envs.core.errors import ConfigError
from envs.torch_env import TorchVectorEnv
from envs.vector_env import RoboVerseVectorEnv

N = 3


def make(**kwargs) -> TorchVectorEnv:
    kwargs = {"bank_size": 5, "num_threads": 1} | kwargs
    return TorchVectorEnv("PickCube", kwargs.pop("num_envs", N), **kwargs)


@pytest.fixture(scope="module", params=["mujoco", "mujoco_warp"])
def env(request):
    env = make(simulator=request.param, max_episode_steps=4)
    yield env
    env.close()


def test_shapes_and_types(env):
    assert (env.observation_size, env.action_size) == (9 + 9 + 9 + 19 + 1, 5)
    step = env.step(torch.zeros(N, 5))
    assert step.obs.shape == step.final_obs.shape == (N, env.observation_size)
    assert step.reward.shape == (N,)
    assert {step.obs.dtype, step.reward.dtype, step.final_obs.dtype} == {torch.float32}
    assert {step.terminated.dtype, step.truncated.dtype, step.success.dtype} == {torch.bool}


def test_an_episode_that_is_over_starts_anew_and_shows_its_end(env):
    env.reset()
    env.pop_statistics()
    for _ in range(3):
        step = env.step(torch.ones(N, 5))
        assert not (step.terminated | step.truncated).any()
        assert torch.equal(step.obs, step.final_obs)
    step = env.step(torch.ones(N, 5))
    assert step.truncated.all() and not step.terminated.any()
    assert not torch.isclose(step.obs[:, :3], step.final_obs[:, :3]).all()
    assert (step.obs[:, 9:18] == 0).all()  # it begins at rest
    assert env.elapsed_steps.tolist() == [0] * N
    statistics = env.pop_statistics()
    assert statistics.episodes == N and statistics.length == 4 and statistics.success_rate == 0
    assert 0 < statistics.episode_return < 4
    assert math.isnan(env.pop_statistics().episode_return)


def test_some_can_be_reset_alone(env):
    env.reset()
    before = env.step(torch.ones(N, 5)).obs
    after = env.reset(torch.tensor([False, True, False]))
    torch.testing.assert_close(after[[0, 2]], before[[0, 2]])
    assert env.elapsed_steps.tolist() == [1, 0, 1]
    assert (after[1, 9:18] == 0).all()


def test_the_seed_decides_which_episodes_come(env):
    env.seed(3)
    first = env.reset()
    env.seed(3)
    assert torch.equal(env.reset(), first)
    env.seed(4)
    assert not torch.equal(env.reset(), first)


def test_staggered_episodes_end_at_different_times():
    env = make(num_envs=16, max_episode_steps=8)
    env.stagger()
    assert len(set(env.elapsed_steps.tolist())) > 3
    assert ((env.elapsed_steps >= 0) & (env.elapsed_steps < 8)).all()
    env.close()


def test_it_sees_and_does_what_the_env_of_an_evaluation_does():
    ours = make(num_envs=1, bank_size=1)
    theirs = RoboVerseVectorEnv("PickCube", 1, split="train", observation="full", actions="rl", num_threads=1)
    theirs.reset_envs([0], theirs.split_indices[:1])
    torch.testing.assert_close(ours.reset()[0].numpy(), theirs.observe()["observation.environment_state"][0])
    generator = torch.Generator().manual_seed(0)
    for _ in range(3):
        action = torch.rand(1, 5, generator=generator) * 2 - 1
        step, told = ours.step(action), theirs.step_envs([0], action.numpy())
        seen = theirs.observe()["observation.environment_state"]
        torch.testing.assert_close(step.obs.numpy(), seen)
        assert float(step.reward) == pytest.approx(float(told.reward[0]) - 1.0, abs=1e-6)
    ours.close()
    theirs.close()


class Pays(TorchVectorEnv):
    """Lets a test say what a step comes to."""

    def judge(self, monkeypatch, *, success=False, failure=False):
        def told(value):
            return lambda _, state: torch.full((state.num_envs,), value)

        for name, value in {"success": success, "failure": failure, "reward": 0.25}.items():
            monkeypatch.setattr(type(self.task), name, told(value))


@pytest.mark.parametrize(
    ("outcome", "shift", "paid"),
    [
        ({}, True, -0.75),
        ({"success": True}, True, 0.0),
        ({"failure": True}, True, -0.75 - 9),  # as if nothing were paid for the nine steps that are left
        ({}, False, 0.25),
        ({"success": True}, False, 1.0),
        ({"failure": True}, False, 0.25),
    ],
)
def test_what_an_agent_is_paid(monkeypatch, outcome, shift, paid):
    env = Pays("PickCube", 2, bank_size=2, num_threads=1, max_episode_steps=10, shift_reward=shift)
    env.judge(monkeypatch, **outcome)
    step = env.step(torch.zeros(2, 5))
    assert step.reward.tolist() == [paid] * 2
    assert step.terminated.tolist() == [bool(outcome)] * 2
    assert step.success.tolist() == [bool(outcome.get("success"))] * 2
    env.close()


def test_no_environments_are_an_error():
    with pytest.raises(ConfigError, match="num_envs must be at least 1, given 0"):
        make(num_envs=0)


def test_a_picture_can_be_had():
    env = make(num_envs=1)
    assert env.picture().ndim == 3
    env.close()


@pytest.mark.parametrize("simulator", ["mujoco", "mujoco_warp"])
def test_it_goes_on_from_a_saved_state(simulator):
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


def test_a_control_step_can_have_fewer_and_longer_physics_steps():
    few, all_of_them = make(num_envs=1, substeps=5), make(num_envs=1)
    assert few.handler.scenario.physics.timestep_s == pytest.approx(0.01)
    step, other = few.step(torch.ones(1, 5)), all_of_them.step(torch.ones(1, 5))
    torch.testing.assert_close(step.obs[:, 18:27], other.obs[:, 18:27])  # targets
    torch.testing.assert_close(step.obs[:, :9], other.obs[:, :9], atol=0.05, rtol=0.0)
    with pytest.raises(ConfigError, match="A control step needs at least 1 physics step, given 0"):
        make(num_envs=1, substeps=0)

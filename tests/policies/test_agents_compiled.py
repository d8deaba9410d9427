"""Updates of agents compile into one graph each, with the results of eager code."""

from dataclasses import replace

import pytest
import torch

from policies.fasttd3.config import FastTd3Config
from policies.fasttd3.policy import FastTd3Policy
from policies.fasttd3.update import Updater as FastTd3Updater
from policies.tdmpc2 import planner
from policies.tdmpc2.agent import Tdmpc2Agent
from policies.tdmpc2.config import Tdmpc2Config
from policies.tdmpc2.policy import Tdmpc2Policy
from policies.tdmpc2.update import Sequences
from policies.tdmpc2.update import Updater as Tdmpc2Updater

OPTIONS = {"backend": "aot_eager", "fullgraph": True}
SIZES = {"observation.environment_state": 5}
TDMPC2 = Tdmpc2Config(
    model_size=1, enc_dim=16, mlp_dim=16, latent_dim=16, num_bins=21, num_samples=16, num_elites=4,
    num_pi_trajs=4, iterations=2, batch_size=8, dropout=0.0,
)  # fmt: skip
FASTTD3 = FastTd3Config(actor_dim=16, critic_dim=16, num_atoms=11, batch_size=8, target_noise=0.0)


@pytest.fixture(autouse=True)
def fresh_compiler():
    torch.compiler.reset()
    yield
    torch.compiler.reset()


def sequences(size):
    generator = torch.Generator().manual_seed(4)
    shape = (TDMPC2.horizon, size)
    return Sequences(
        observations=torch.randn(TDMPC2.horizon + 1, size, 5, generator=generator),
        actions=torch.rand(*shape, 2, generator=generator) * 2 - 1,
        rewards=torch.randn(shape, generator=generator),
        terminated=(torch.rand(shape, generator=generator) < 0.2).float(),
        valid=(torch.rand(shape, generator=generator) < 0.9).float(),
    )


@pytest.mark.long
def test_the_loss_of_tdmpc2_of_images():
    cameras = {"observation.images.front": 64}
    config = replace(TDMPC2, observation="pixels", num_channels=4)
    policy = Tdmpc2Policy.create(config, cameras, 2, 100)
    updater = Tdmpc2Updater(config, policy.model.train(), [policy.discount])
    generator = torch.Generator().manual_seed(4)
    images = torch.randint(0, 256, (4, 8, 9, 64, 64), dtype=torch.uint8, generator=generator)
    batch = sequences(8)._replace(observations=images)
    losses = []
    for function in (updater.world_loss, torch.compile(updater.world_loss, **OPTIONS)):
        torch.manual_seed(0)
        losses.append(function(batch)[0])
    torch.testing.assert_close(losses[1], losses[0])


@pytest.mark.long
@pytest.mark.parametrize("episodic", [True, False])
def test_updates_of_tdmpc2(episodic):
    def learned(compiled):
        policy = Tdmpc2Policy.create(replace(TDMPC2, episodic=episodic), SIZES, 2, 100)
        updater = Tdmpc2Updater(policy.config, policy.model, [policy.discount])
        if compiled:
            updater._world_loss = torch.compile(updater.world_loss, **OPTIONS)
            updater._prior_loss = torch.compile(updater.prior_loss, **OPTIONS)
        updater.model.random_pair = lambda: torch.tensor([0, 1])
        torch.manual_seed(0)
        for _ in range(2):
            terms = updater.update(sequences(8))
        return policy.state_dict(), terms

    (expected, _), (found, terms) = learned(False), learned(True)
    assert all(value.isfinite() for value in terms.values())
    for key in ("dynamics.0.weight", "encoder.0.weight", "q.weights.2", "target_q.weights.2"):
        torch.testing.assert_close(found[key], expected[key], rtol=1e-3, atol=1e-4)


@pytest.mark.long
@pytest.mark.parametrize("num_envs", [7, 1])
def test_planning_of_tdmpc2_in_any_number_of_environments(num_envs):
    policy = Tdmpc2Policy.create(TDMPC2, SIZES, 2, 100)
    agents = [Tdmpc2Agent(TDMPC2, policy.model, 0.9, num_envs) for _ in range(2)]
    agents[1]._improve = torch.compile(planner.improved, **OPTIONS)
    policy.model.random_pair = lambda: torch.tensor([1, 0])
    found = []
    for agent in agents:
        agent._normal = torch.zeros  # the same samples, compiled or not
        torch.manual_seed(1)
        found.append(agent.act(torch.ones(num_envs, 5), torch.ones(num_envs, dtype=torch.bool)))
    torch.testing.assert_close(found[0], found[1], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(agents[0].mean, agents[1].mean, rtol=1e-4, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("bf16", [True, pytest.param(False, marks=pytest.mark.long)])
def test_updates_of_fasttd3(bf16):
    def learned(compiled):
        policy = FastTd3Policy.create(FASTTD3, SIZES, 2)
        updater = FastTd3Updater(FASTTD3, policy.actor, policy.critics, policy.norm, bf16=bf16)
        if compiled:
            updater._critic_loss = torch.compile(updater.critic_loss, **OPTIONS)
            updater._actor_loss = torch.compile(updater.actor_loss, **OPTIONS)
        given = sequences(8)
        for _ in range(2):
            updater.update(
                given.observations[0], given.actions[0], given.rewards[0], given.terminated[0],
                given.observations[1],
            )  # fmt: skip
        return policy.state_dict()

    expected, found = learned(False), learned(True)
    for key, value in expected.items():
        torch.testing.assert_close(found[key], value, rtol=1e-2, atol=1e-3 if bf16 else 1e-5)

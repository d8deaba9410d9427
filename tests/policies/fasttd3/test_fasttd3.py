"""FastTD3 against closed forms: projection, targets, losses, normalization; and as a policy."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from envs.core.errors import PolicyError
from policies import Policy
from policies.fasttd3.config import FastTd3Config
from policies.fasttd3.networks import RunningNorm, project
from policies.fasttd3.policy import FastTd3Policy
from policies.fasttd3.update import Updater

TINY = FastTd3Config(actor_dim=16, critic_dim=16, num_atoms=11, v_min=-5.0, v_max=5.0, target_noise=0.0)
SIZES = {"observation.environment_state": 3}
B = 32


def make(config=TINY, seed=0):
    policy = FastTd3Policy.create(config, SIZES, 2, seed=seed)
    return policy, Updater(config, policy.actor, policy.critics, policy.norm)


def batch(seed=1):
    g = torch.Generator().manual_seed(seed)
    discount = 0.99 * (torch.rand(B, generator=g) > 0.3).float()
    actions = torch.rand(B, 2, generator=g) * 2 - 1
    first, last = torch.randn(2, B, 3, generator=g)
    return first, actions, torch.randn(B, generator=g), discount, last


def test_the_projection_gives_each_mass_to_its_two_neighbours():
    atoms, values = torch.linspace(-1, 1, 5), torch.tensor([[-3.0, -0.6, 0.0, 0.25, 2.0]])
    masses = torch.tensor([[0.1, 0.2, 0.3, 0.15, 0.25]])
    # -3 and 2 lie beyond the ends; -0.6 is 0.8 of the way from -1 to -0.5... that is 0.2 and 0.8.
    expected = [[0.1 + 0.04, 0.16, 0.3 + 0.075, 0.075, 0.25]]
    torch.testing.assert_close(project(masses, values, atoms), torch.tensor(expected))


def test_a_projection_onto_itself_is_the_identity_and_the_mean_is_kept():
    atoms = torch.linspace(-250.0, 250.0, 101)
    masses = torch.softmax(torch.randn(2, 7, 101), -1)
    torch.testing.assert_close(project(masses, atoms[None], atoms), masses, atol=1e-5, rtol=1e-4)
    values = atoms[None] * 0.9 + torch.linspace(-5.0, 5.0, 7)[:, None]
    projected = project(masses, values, atoms)
    torch.testing.assert_close(projected.sum(-1), torch.ones(2, 7))
    torch.testing.assert_close((projected * atoms).sum(-1), (masses * values).sum(-1), atol=1e-3, rtol=1e-4)


def test_the_target_is_the_lesser_critic_shifted_and_shrunk():
    _, updater = make()
    with torch.no_grad():
        for parameter in updater.target.parameters():
            parameter.zero_()
        for critic, atom in enumerate((7, 9)):  # all mass on the values 2 and 4
            updater.target.biases[-1][critic, 0, atom] = 50.0
    reward, discount = torch.tensor([0.5, 0.5]), torch.tensor([0.99, 0.0])
    targets = updater.targets(reward, discount, torch.randn(2, 3))
    value = updater.critics.value(targets)
    torch.testing.assert_close(value, torch.tensor([[0.5 + 0.99 * 2.0, 0.5]] * 2))
    _, own = make(replace(TINY, clipped_double=False))
    own.target.load_state_dict(updater.target.state_dict())
    value = own.critics.value(own.targets(reward, discount, torch.randn(2, 3)))
    torch.testing.assert_close(value[:, 0], torch.tensor([0.5 + 0.99 * 2.0, 0.5 + 0.99 * 4.0]))


def test_values_that_do_not_fit_between_the_limits_show():
    _, updater = make()
    shares = []
    for reward in (0.0, 50.0):
        observation, action, _, _, following = batch()
        given = (observation, action, torch.full((B,), reward), torch.zeros(B), following)
        shares.append(float(updater.critic_loss(*given)[1]["mass_at_limits"]))
    assert shares == pytest.approx([0.0, 1.0])


def test_the_target_moves_by_tau_and_the_actor_every_second_time():
    policy, updater = make()
    before = [value.clone() for value in updater.target.parameters()]
    acting = policy.actor.layers[0].weight.clone()
    updater.update(*batch())
    assert policy.actor.layers[0].weight.equal(acting)
    for old, new, present in zip(
        before, updater.target.parameters(), policy.critics.parameters(), strict=True
    ):
        torch.testing.assert_close(new, 0.9 * old + 0.1 * present)
    updater.update(*batch())
    assert not policy.actor.layers[0].weight.equal(acting)


def test_actor_maximizes_the_smaller_value_without_changing_critics():
    policy, updater = make()
    observation = batch()[0]
    loss = updater.actor_loss(observation)
    seen = policy.norm(observation)
    values = policy.critics.value(torch.softmax(policy.critics(seen, policy.actor(seen)), -1))
    torch.testing.assert_close(loss, -values.min(0).values.mean())
    loss.backward()
    assert all(p.grad is None for p in policy.critics.parameters())
    assert all(p.grad is not None for p in policy.actor.parameters())


@pytest.mark.slow
@pytest.mark.parametrize("layer_norm", [False, True])
def test_updates_fit_a_batch_and_are_repeatable(layer_norm):
    def losses():
        _, updater = make(replace(TINY, layer_norm=layer_norm, lr=3e-3))
        torch.manual_seed(0)
        return [float(updater.update(*batch())["loss"]) for _ in range(100)]

    first = losses()
    assert first[-1] < 0.95 * first[0] and first == losses()


@pytest.mark.slow
def test_both_losses_compile_without_a_break():
    _, updater = make()
    options = {"backend": "eager", "fullgraph": True}
    expected, _ = updater.critic_loss(*batch())
    found, _ = torch.compile(updater.critic_loss, **options)(*batch())
    torch.testing.assert_close(found, expected)
    torch.compile(updater.actor_loss, **options)(batch()[0])


def test_the_normalization_is_that_of_all_that_was_seen():
    seen = torch.randn(100, 3) * torch.tensor([1.0, 5.0, 0.1]) + torch.tensor([0.0, -3.0, 40.0])
    norm = RunningNorm(3)
    for part in seen.split([10, 50, 40]):
        norm.update(part)
    torch.testing.assert_close(norm.mean, seen.mean(0), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(norm.var, seen.var(0, correction=0), rtol=1e-3, atol=1e-4)
    torch.testing.assert_close(norm(norm.mean), torch.zeros(3))


def test_the_policy_acts_alike_alone_and_after_loading(tmp_path):
    policy, _ = make()
    policy.norm.update(torch.randn(50, 3) * 4)
    seen = {"observation.environment_state": np.random.default_rng(0).normal(size=(4, 3))}
    actions = policy.act(seen)
    assert isinstance(policy, Policy) and actions.shape == (4, 1, 2) and actions.dtype == np.float32
    np.testing.assert_array_equal(policy.act({key: value[2:3] for key, value in seen.items()}), actions[2:3])
    policy.save(tmp_path)
    np.testing.assert_array_equal(FastTd3Policy.load(tmp_path).act(seen), actions)
    with pytest.raises(PolicyError, match=r"'observation.environment_state' has shape \(4, 2\)"):
        policy.act({key: value[:, :2] for key, value in seen.items()})


def test_a_checkpoint_of_another_policy_is_an_error(tmp_path):
    make()[0].save(tmp_path)
    text = (tmp_path / "config.json").read_text()
    (tmp_path / "config.json").write_text(text.replace('"fasttd3"', '"act"'))
    with pytest.raises(PolicyError, match="is of policy 'act', not of 'fasttd3'"):
        FastTd3Policy.load(tmp_path)
    (tmp_path / "config.json").write_text(text.replace('"tau"', '"tow"'))
    with pytest.raises(PolicyError, match=r"is not a configuration of policy 'fasttd3'.*tow"):
        FastTd3Policy.load(tmp_path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"actor_dim": 30}, "policy.actor_dim must be a multiple of 4, given 30"),
        ({"v_min": 300.0}, "policy.v_min=300.0 below policy.v_max=250.0"),
        ({"std_min": 0.5}, "policy.std_min=0.5 must be at most policy.std_max=0.4"),
        ({"discount": 1.0}, "policy.discount must be from 0 to below 1"),
        ({"batch_size": 0}, "policy.batch_size must be above 0, given 0"),
        ({"num_steps": 0}, "policy.num_steps must be above 0, given 0"),
        ({"weight_decay": -1.0}, "policy.weight_decay must be 0 or more"),
    ],
)
def test_the_config_is_checked(changes, message):
    with pytest.raises(PolicyError, match=message):
        FastTd3Config(**changes)

"""The world model, its losses and targets, and several tasks in one model, by hand."""

from dataclasses import replace

import pytest
import torch
from torch.nn import functional

from envs.core.errors import PolicyError
from policies.tdmpc2 import planner
from policies.tdmpc2.agent import Tdmpc2Agent
from policies.tdmpc2.config import ARCHITECTURES, Tdmpc2Config
from policies.tdmpc2.update import Sequences, Updater
from policies.tdmpc2.world_model import WorldModel

D, A, B = 5, 2, 16
TINY = Tdmpc2Config(
    model_size=1, enc_dim=16, mlp_dim=16, latent_dim=16, num_bins=21, num_samples=32, num_elites=8,
    num_pi_trajs=4, iterations=2, batch_size=B, task_dim=4, dropout=0.0,
)  # fmt: skip


def make(config=TINY, shape=(D,), action_sizes=(A,)) -> WorldModel:
    torch.manual_seed(0)
    return WorldModel(config, shape, action_sizes)


def batch(seed: int = 1, size: int = A, task=None) -> Sequences:
    generator = torch.Generator().manual_seed(seed)
    return Sequences(
        observations=torch.randn(4, B, D, generator=generator),
        actions=torch.rand(3, B, size, generator=generator) * 2 - 1,
        rewards=torch.randn(3, B, generator=generator),
        terminated=(torch.rand(3, B, generator=generator) < 0.2).float(),
        valid=torch.ones(3, B),
        task=task,
    )


@pytest.mark.parametrize("size", ARCHITECTURES)
def test_sizes_are_the_published_ones(size):
    config = Tdmpc2Config(model_size=size, episodic=False)
    with torch.device("meta"):
        model = WorldModel(config, (51,), (19,))
    count = sum(p.numel() for p in model.parameters() if p.requires_grad) / 1e6
    assert count == pytest.approx(size, rel=0.06 if size > 1 else 0.3)  # of 51 numbers observed, 19 actions


def test_rewards_and_values_are_zero_at_first():
    model, z, action = make(), torch.rand(B, 16), torch.rand(B, A)
    torch.testing.assert_close(model.reward(z, action), torch.zeros(B), atol=1e-5, rtol=0)
    torch.testing.assert_close(model.values(z, action), torch.zeros(B), atol=1e-5, rtol=0)


def test_the_target_moves_by_tau():
    model = make()
    before = {key: value.clone() for key, value in model.target_q.state_dict().items()}
    with torch.no_grad():
        for parameter in model.q.parameters():
            parameter.add_(1.0)
    model.update_target()
    for key, value in model.target_q.state_dict().items():
        torch.testing.assert_close(value, before[key] + TINY.tau)


def test_a_pair_is_two_different_members():
    model = make(Tdmpc2Config(enc_dim=16, mlp_dim=16, latent_dim=16))
    pairs = {tuple(sorted(model.random_pair().tolist())) for _ in range(200)}
    assert len(pairs) == 10  # of five


def test_targets_are_reward_and_the_lesser_discounted_value():
    model, given = make(), batch()
    updater = Updater(TINY, model, [0.9])
    with torch.no_grad():  # values that do not depend on the action: 2 and 5
        for member, value in enumerate((2.0, 5.0)):
            code = model.two_hot.encode(torch.tensor([value])).clamp(min=1e-9).log()
            model.target_q.biases[-1][member] = code
        targets = updater.targets(torch.rand(3, B, 16), given)
    expected = given.rewards + 0.9 * (1.0 - given.terminated) * 2.0
    torch.testing.assert_close(targets, expected, rtol=1e-3, atol=1e-3)


def test_without_ends_every_state_is_bootstrapped():
    config = Tdmpc2Config(model_size=1, enc_dim=16, mlp_dim=16, latent_dim=16, episodic=False)
    model, given = make(config), batch()
    assert model.termination_head is None and not model.ended(torch.rand(B, 16)).any()
    with torch.no_grad():
        code = model.two_hot.encode(torch.tensor([2.0])).clamp(min=1e-9).log()
        model.target_q.biases[-1][:] = code
        targets = Updater(config, model, [0.9]).targets(torch.rand(3, B, 16), given)
    torch.testing.assert_close(targets, given.rewards + 1.8, rtol=1e-3, atol=1e-3)


def test_the_world_loss_by_hand():
    model, given = make(), batch()
    updater = Updater(TINY, model, [0.9])
    torch.manual_seed(3)
    loss, zs, terms = updater.world_loss(given)
    torch.manual_seed(3)
    next_z = model.encode(given.observations[1:])
    targets = updater.targets(next_z, given).detach()
    z, consistency, reward, value, ended = model.encode(given.observations[0]), 0.0, 0.0, 0.0, 0.0
    for t in range(3):
        reward += (
            0.5**t * model.two_hot.loss(model.reward_logits(z, given.actions[t]), given.rewards[t]).mean()
        )
        for q in model.q_logits(z, given.actions[t]):
            value += 0.5**t * model.two_hot.loss(q, targets[t]).mean()
        z = model.next(z, given.actions[t])
        torch.testing.assert_close(zs[t + 1], z.detach())
        consistency += 0.5**t * functional.mse_loss(z, next_z[t].detach())
        chance = torch.sigmoid(model.termination_logits(z))
        ended += functional.binary_cross_entropy(chance, given.terminated[t])
    torch.testing.assert_close(terms["consistency_loss"], consistency / 3)
    torch.testing.assert_close(terms["reward_loss"], reward / 3)
    torch.testing.assert_close(terms["value_loss"], value / 6)
    torch.testing.assert_close(terms["termination_loss"], ended / 3)
    torch.testing.assert_close(loss, 20 * consistency / 3 + 0.1 * reward / 3 + 0.1 * value / 6 + ended / 3)


def test_steps_after_an_episode_end_change_no_loss():
    model, given = make(), batch()
    torch.nn.init.normal_(model.reward_head[-1].weight)
    updater = Updater(TINY, model, [0.9])
    valid = given.valid.clone()
    valid[1:, 0] = valid[2, 1] = 0.0

    def losses(rewards):
        torch.manual_seed(3)
        here = given._replace(rewards=rewards, valid=valid, terminated=given.terminated * valid)
        loss, zs, _ = updater.world_loss(here)
        return torch.stack([loss, updater.prior_loss(zs, here)[0]])

    other = torch.where(valid > 0, given.rewards, 7.0)
    torch.testing.assert_close(losses(given.rewards), losses(other))
    assert not losses(given.rewards)[0].allclose(losses(torch.where(valid > 0, 7.0, given.rewards))[0])


def test_the_policy_prior_climbs_values_and_leaves_them_alone():
    model = make()
    updater = Updater(TINY, model, [0.9])
    loss, _ = updater.prior_loss(torch.rand(4, B, 16), batch())
    loss.backward()
    moved = {name.partition(".")[0] for name, p in model.named_parameters() if p.grad is not None}
    assert moved == {"prior_head"}


def test_the_entropy_is_that_of_a_squashed_gaussian():
    model, z = make(), torch.rand(1, 16)
    noise = torch.tensor([[0.3, -0.8]])
    sample = model.prior(z, noise)
    mean, log_std = model.prior_head(z).chunk(2, -1)
    std = (-10 + 6 * (torch.tanh(log_std) + 1)).exp()
    raw = mean + noise * std
    torch.testing.assert_close(sample.action, torch.tanh(raw))
    gaussian = torch.distributions.Normal(mean, std).log_prob(raw).sum(-1)
    # The authors scale by the action's size, and count the constant of the density once.
    constant = 0.5 * torch.log(torch.tensor(2 * torch.pi))
    scaled = (gaussian + constant * A - constant) * A
    expected = -scaled + torch.log(1 - torch.tanh(raw) ** 2 + 1e-6).sum(-1)
    torch.testing.assert_close(sample.entropy, expected, rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_updates_fit_a_batch_and_are_repeatable():
    def losses():
        updater = Updater(replace(TINY, lr=3e-3), make(), [0.9])
        torch.manual_seed(0)
        return [updater.update(batch()) for _ in range(60)]

    first, second = losses(), losses()
    assert float(first[-1]["reward_loss"]) < 0.7 * float(first[0]["reward_loss"])
    assert float(first[-1]["termination_loss"]) < 0.9 * float(first[0]["termination_loss"])
    assert all(a[key].equal(b[key]) for a, b in zip(first, second, strict=True) for key in a)


@pytest.mark.slow
def test_both_losses_and_the_search_compile_without_a_break():
    model = make()
    updater, agent = Updater(TINY, model, [0.9]), Tdmpc2Agent(TINY, model, 0.9, 3)
    options = {"backend": "eager", "fullgraph": True}
    torch.manual_seed(5)
    expected, zs, _ = updater.world_loss(batch())
    torch.manual_seed(5)
    found, _, _ = torch.compile(updater.world_loss, **options)(batch())
    torch.testing.assert_close(found, expected)
    torch.compile(updater.prior_loss, **options)(zs, batch())
    agent._improve = torch.compile(planner.improved, **options)
    assert agent.act(torch.randn(3, D), torch.ones(3, dtype=torch.bool)).abs().max() <= 1.0


def test_images_are_learned_from_too():
    model = make(shape=(3, 64, 64))
    images = torch.randint(0, 256, (4, B, 3, 64, 64), dtype=torch.uint8)
    metrics = Updater(TINY, model, [0.9]).update(batch()._replace(observations=images))
    assert all(value.isfinite() for value in metrics.values())


@pytest.mark.parametrize(("latent_dim", "apart"), [(64, 5e-4), (32, 2e-3)])
def test_different_images_have_different_initial_latent_states(latent_dim, apart):
    config = replace(TINY, latent_dim=latent_dim, num_channels=4)  # of 4 channels are 64 numbers
    bars = torch.zeros(16, 3, 64, 64, dtype=torch.uint8)
    for i, image in enumerate(bars):
        image[:, :, 4 * i : 4 * i + 4] = 255
    z = make(config, shape=(3, 64, 64)).eval().encode(bars)
    torch.testing.assert_close(z.unflatten(-1, (-1, 8)).sum(-1), torch.ones(16, latent_dim // 8))
    assert z.std(0).mean() > apart


def test_shapes_that_cannot_be_encoded_are_an_error():
    with pytest.raises(PolicyError, match=r"given the shape \(3, 32, 32\).*image_size=64"):
        make(shape=(3, 32, 32))


# --- several tasks ------------------------------------------------------------------------------


def test_padded_actions_are_zero_and_do_not_count():
    model = make(action_sizes=(1, 3))
    z, noise, task = torch.rand(B, 16), torch.randn(B, 3), torch.arange(B) % 2
    sample = model.prior(z, noise, task)
    assert not sample.action[::2, 1:].any() and sample.action[1::2].all()
    other = model.prior(z, noise * torch.tensor([1.0, 9.0, 9.0]), task)
    torch.testing.assert_close(sample.entropy[::2], other.entropy[::2])


def test_task_embeddings_differ_and_have_norm_at_most_one():
    model = make(action_sizes=(2, 2))
    z, action = torch.rand(B, 16), torch.rand(B, 2)
    torch.nn.init.normal_(model.task_embedding.weight)
    first = model.next(z, action, torch.zeros(B, dtype=torch.long))
    assert not first.allclose(model.next(z, action, torch.ones(B, dtype=torch.long)))
    with torch.no_grad():
        model.task_embedding.weight *= 1000.0
    again = model.next(z, action, torch.zeros(B, dtype=torch.long))
    torch.testing.assert_close(first, again)


def test_tasks_have_discounts_of_their_own_and_learn_together():
    model = make(action_sizes=(1, 3))
    task = torch.arange(B) % 2
    given = batch(size=3, task=task)
    updater = Updater(TINY, model, [0.5, 0.9])
    with torch.no_grad():
        model.target_q.biases[-1][:] = model.two_hot.encode(torch.tensor([2.0])).clamp(min=1e-9).log()
        targets = updater.targets(torch.rand(3, B, 16), given._replace(terminated=torch.zeros(3, B)))
    expected = given.rewards + 2.0 * torch.tensor([0.5, 0.9])[task]
    torch.testing.assert_close(targets, expected, rtol=1e-3, atol=1e-3)
    assert updater.update(given)["loss"].isfinite()


def test_multi_task_model_needs_a_task():
    with pytest.raises(PolicyError, match="has 2 tasks: say which"):
        make(action_sizes=(2, 2)).encode(torch.rand(B, D))


# --- acting -------------------------------------------------------------------------------------


def test_agent_warm_starts_and_resets_with_an_episode(monkeypatch):
    agent = Tdmpc2Agent(TINY, make().eval(), 0.9, 2)
    starts = []

    def improve(config, model, z, of_prior, mean, std, *rest):
        starts.append(mean.clone())
        return planner.improved(config, model, z, of_prior, mean, std, *rest)

    agent._improve = improve
    observation, new = torch.randn(2, D), torch.tensor([True, True])
    agent.act(observation, new)
    assert not starts[0].any()
    last = agent.mean.clone()
    agent.act(observation, torch.tensor([False, True]))
    torch.testing.assert_close(starts[TINY.iterations][0, :-1], last[0, 1:])
    assert not starts[TINY.iterations][1].any()


def test_without_planning_the_agent_samples_its_prior():
    config = Tdmpc2Config(model_size=1, enc_dim=16, mlp_dim=16, latent_dim=16, plan=False)
    agent = Tdmpc2Agent(config, make(config).eval(), 0.9, 2)
    observation, new = torch.randn(2, D), torch.ones(2, dtype=torch.bool)
    assert not agent.act(observation, new).equal(agent.act(observation, new))

"""Layers, bins, scale and discount of TD-MPC2 against closed forms."""

import importlib.util
import math
import re
import sys

import numpy as np
import pytest
import torch
from torch.nn import functional

from envs.core.errors import PolicyError
from envs.core.extras import install_command
from policies.tdmpc2.config import ARCHITECTURES, Tdmpc2Config
from policies.tdmpc2.layers import PixelEncoder, QEnsemble, ShiftAug, SimNorm, mlp
from policies.tdmpc2.scale import RunningScale, percentile
from policies.tdmpc2.two_hot import TwoHot


def test_without_torchrl_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "torchrl.modules.functional", None)  # as if it were not there
    source = importlib.util.find_spec("policies.tdmpc2.two_hot")
    needed = f"needs the package 'torchrl', .*{re.escape(install_command('torchrl'))}"
    with pytest.raises(PolicyError, match=needed):
        source.loader.exec_module(importlib.util.module_from_spec(source))


def test_every_simplex_of_simnorm_sums_to_one():
    z = SimNorm(8)(torch.randn(3, 5, 64))
    assert z.shape == (3, 5, 64) and (z >= 0).all()
    torch.testing.assert_close(z.unflatten(-1, (8, 8)).sum(-1), torch.ones(3, 5, 8))


def test_simnorm_is_a_softmax_of_neighbouring_entries():
    torch.testing.assert_close(SimNorm(2)(torch.tensor([0.0, math.log(3.0), 1.0, 1.0])),
                               torch.tensor([0.25, 0.75, 0.5, 0.5]))  # fmt: skip


def test_an_mlp_is_linear_norm_mish_and_a_linear_end():
    torch.manual_seed(0)
    net, x = mlp(3, [4], 2), torch.randn(5, 3)
    first, last = net[0], net[1]
    hidden = functional.mish(functional.layer_norm(x @ first.weight.T + first.bias, (4,)))
    torch.testing.assert_close(net(x), hidden @ last.weight.T + last.bias)


@pytest.fixture
def ensemble():
    torch.manual_seed(0)
    ensemble = QEnsemble(4, 3, 6, 5, dropout=0.5).eval()
    torch.nn.init.normal_(ensemble.weights[-1])
    return ensemble


def test_a_member_of_the_ensemble_is_an_mlp_of_its_own(ensemble):
    x = torch.randn(2, 7, 3)
    out = ensemble(x)
    assert out.shape == (4, 2, 7, 5)
    for i in range(4):
        h = x
        for layer in range(2):
            h = h @ ensemble.weights[layer][i] + ensemble.biases[layer][i]
            h = functional.mish(
                functional.layer_norm(h, (6,), ensemble.scales[layer][i, 0], ensemble.shifts[layer][i, 0])
            )
        expected = h @ ensemble.weights[2][i] + ensemble.biases[2][i]
        torch.testing.assert_close(out[i], expected)


def test_some_members_are_evaluated_without_the_others(ensemble):
    x, pair = torch.randn(7, 3), torch.tensor([2, 0])
    torch.testing.assert_close(ensemble(x, pair), ensemble(x)[pair])


def test_no_gradient_reaches_detached_members(ensemble):
    x = torch.randn(7, 3, requires_grad=True)
    ensemble(x, detached=True).sum().backward()
    assert x.grad is not None and all(parameter.grad is None for parameter in ensemble.parameters())


def test_dropout_is_in_training_alone(ensemble):
    x = torch.randn(7, 3)
    assert ensemble(x).equal(ensemble(x))
    ensemble.train()
    assert not ensemble(x).equal(ensemble(x))


def test_images_are_shifted_by_whole_pixels_and_borders_repeated():
    image = torch.arange(16.0).reshape(1, 1, 4, 4)
    shifted = ShiftAug(1)(image, torch.tensor([[1, -1]]))
    assert shifted[0, 0].tolist() == [[1, 2, 3, 3], [1, 2, 3, 3], [5, 6, 7, 7], [9, 10, 11, 11]]
    assert ShiftAug(1)(image, torch.tensor([[0, 0]])).equal(image)


def test_the_pixel_encoder_has_the_published_size():
    encoder = PixelEncoder(9, 32, 512, 8)
    assert sum(p.numel() for p in encoder.parameters()) == sum(
        (a * k * k + 1) * 32 for a, k in ((9, 7), (32, 5), (32, 3), (32, 3))
    )  # the convolutions end in 512 numbers, so that no linear layer is needed
    z = encoder(torch.randint(0, 256, (2, 3, 9, 64, 64), dtype=torch.uint8))
    assert z.shape == (2, 3, 512)


def test_images_are_shifted_in_training_only():
    encoder, images = PixelEncoder(3, 4, 16, 8), torch.randint(0, 256, (2, 3, 64, 64), dtype=torch.uint8)
    encoder.eval()
    assert encoder(images).equal(encoder(images))
    torch.testing.assert_close(encoder(images.float()), encoder(images))
    encoder.train()
    assert not encoder(images).equal(encoder(images))


@pytest.mark.parametrize("value", [0.0, 0.3, -1.7, 250.0, -9000.0])
def test_two_hot_round_trip(value):
    two_hot, value = TwoHot(101, 10.0), torch.tensor([value])
    code = two_hot.encode(value)
    assert code.shape == (1, 101) and int((code > 0).sum()) <= 2
    torch.testing.assert_close(code.sum(-1), torch.ones(1))
    torch.testing.assert_close(two_hot.decode(code.clamp(min=1e-30).log()), value, rtol=1e-4, atol=1e-5)


def test_two_hot_weights_are_the_distances_to_the_neighbours():
    code = TwoHot(21, 10.0).encode(torch.tensor([math.expm1(2.25)]))  # bins are 1 apart; symlog is 2.25
    torch.testing.assert_close(code[0, 12:14], torch.tensor([0.75, 0.25]), rtol=1e-4, atol=1e-5)


def test_values_beyond_the_bins_saturate():
    assert TwoHot(21, 10.0).encode(torch.tensor([1e9]))[0, -1] == 1.0


def test_the_loss_is_a_cross_entropy():
    two_hot, logits = TwoHot(21, 10.0), torch.zeros(3, 21)
    torch.testing.assert_close(two_hot.loss(logits, torch.randn(3)), torch.full((3,), np.log(21.0)).float())


def test_uniform_logits_are_worth_nothing():
    assert (TwoHot(101, 10.0).decode(torch.zeros(2, 101)).abs() < 1e-6).all()


@pytest.mark.parametrize("percent", [5.0, 50.0, 95.0])
def test_percentiles_are_those_of_numpy(percent):
    values = torch.randn(257)
    assert float(percentile(values, percent)) == pytest.approx(
        np.percentile(values.numpy(), percent), abs=1e-6
    )


def test_the_scale_follows_the_range_and_is_one_at_least():
    scale = RunningScale(0.25)
    scale.update(torch.linspace(0.0, 1000.0, 1001))  # from the 5th to the 95th percentile: 900
    assert float(scale.value) == pytest.approx(0.75 * 1.0 + 0.25 * 900.0)
    assert float(scale(torch.tensor(225.75))) == pytest.approx(1.0)
    small = RunningScale(1.0)
    small.update(torch.linspace(0.0, 0.1, 11))
    assert float(small.value) == 1.0


@pytest.mark.parametrize(
    ("length", "discount"),
    [(1000, 0.995), (500, 0.99), (200, 0.975), (100, 0.95), (10, 0.95), (100_000, 0.995)],
)
def test_the_discount_follows_from_the_length_of_an_episode(length, discount):
    assert Tdmpc2Config().discount(length) == pytest.approx(discount)


def test_seed_steps_are_five_episodes():
    assert Tdmpc2Config().first_steps(1000) == 5000
    assert Tdmpc2Config().first_steps(50) == 1000
    assert Tdmpc2Config(seed_steps=7).first_steps(50) == 7


def test_large_actions_take_two_iterations_more():
    assert [Tdmpc2Config().planning_iterations(size) for size in (19, 20)] == [6, 8]


def test_a_model_size_sets_what_is_not_given():
    config = Tdmpc2Config(model_size=19, mlp_dim=128)
    assert (config.architecture.mlp_dim, config.architecture.enc_dim) == (128, ARCHITECTURES[19].enc_dim)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model_size": 7}, r"policy.model_size=7 is none of the published sizes: 1, 5, 19, 48, 317"),
        ({"latent_dim": 12}, "policy.latent_dim=12 must be a multiple of policy.simnorm_dim=8"),
        ({"num_elites": 600}, "can be at most policy.num_samples=512"),
        ({"horizon": 0}, "policy.horizon must be above 0, given 0"),
        ({"num_q": 1}, "policy.num_q must be at least 2, given 1"),
        ({"min_std": 3.0}, r"policy.min_std=3.0 must be at most policy.max_std=2.0"),
        ({"discount_max": 1.0}, "policy.discount_max=1.0 must be from 0 to below 1"),
        ({"num_bins": 2}, "policy.num_bins must be at least 3"),
        ({"seed_steps": -1}, "policy.seed_steps must be 0 or more"),
    ],
)
def test_the_config_is_checked(changes, message):
    with pytest.raises(PolicyError, match=message):
        Tdmpc2Config(**changes)

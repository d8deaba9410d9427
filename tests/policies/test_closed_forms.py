"""The arithmetic of both policies against the papers' formulas, and normalization by hand."""

import math

import numpy as np
import pytest
import torch

import policies
from policies.normalization import policy_stats
from tests.policies.examples import CONFIGS, FEATURES, IMAGE, LEARNED, SIZE, make, observation, stats

STEPS = 20


@pytest.fixture(autouse=True)
def _seeded():
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        yield


def alpha_bars():
    """Cosine schedule (arXiv:2102.09672, eq. 17), betas at most 0.999."""
    f = [math.cos((t / STEPS + 0.008) / 1.008 * math.pi / 2) ** 2 for t in range(STEPS + 1)]
    betas = [min(1 - f[t + 1] / f[t], 0.999) for t in range(STEPS)]
    return np.array(betas), np.cumprod(1 - np.array(betas))


def scheduler(kind):
    """The scheduler that acting uses, with one inference step per training step."""
    policy = make("diffusion", noise_scheduler_type=kind, num_train_timesteps=STEPS)
    noise_scheduler = policy.model.diffusion.noise_scheduler
    noise_scheduler.set_timesteps(STEPS)
    return noise_scheduler


class TestDenoising:
    @pytest.mark.slow
    @pytest.mark.parametrize("t", [1, 6, 13, 18])
    def test_a_ddpm_step_is_the_posterior(self, t):
        """arXiv:2006.11239, eq. 7 and 15, with the predicted clean action clipped to [-1, 1]."""
        betas, bars = alpha_bars()
        x, eps = torch.randn(3, 8, 9), torch.randn(3, 8, 9)
        clean = ((x - math.sqrt(1 - bars[t]) * eps) / math.sqrt(bars[t])).clamp(-1, 1)
        mean = (
            math.sqrt(bars[t - 1]) * betas[t] / (1 - bars[t]) * clean
            + math.sqrt(1 - betas[t]) * (1 - bars[t - 1]) / (1 - bars[t]) * x
        )
        noise = torch.randn(x.shape, generator=torch.Generator().manual_seed(4))
        expected = mean + math.sqrt((1 - bars[t - 1]) / (1 - bars[t]) * betas[t]) * noise
        generator = torch.Generator().manual_seed(4)
        step = scheduler("DDPM").step(eps, t, x, generator=generator).prev_sample
        torch.testing.assert_close(step, expected.float(), atol=1e-4, rtol=1e-4)

    @pytest.mark.slow
    @pytest.mark.parametrize("t", [1, 6, 13, 18])
    def test_ddim_step_is_deterministic(self, t):
        """arXiv:2010.02502, eq. 12, with sigma = 0."""
        _, bars = alpha_bars()
        x, eps = torch.randn(3, 8, 9), torch.randn(3, 8, 9)
        clean = ((x - math.sqrt(1 - bars[t]) * eps) / math.sqrt(bars[t])).clamp(-1, 1)
        expected = math.sqrt(bars[t - 1]) * clean + math.sqrt(1 - bars[t - 1]) * eps
        before = torch.get_rng_state()
        step = scheduler("DDIM").step(eps, t, x).prev_sample
        torch.testing.assert_close(step, expected.float(), atol=1e-4, rtol=1e-4)
        assert torch.get_rng_state().equal(before)

    @pytest.mark.slow
    @pytest.mark.parametrize("kind", ["DDPM", "DDIM"])
    def test_exact_noise_prediction_recovers_clean_actions(self, kind):
        _, bars = alpha_bars()
        noise_scheduler, clean = scheduler(kind), torch.rand(2, 8, 9) * 1.6 - 0.8
        x = torch.randn(2, 8, 9)
        for t in noise_scheduler.timesteps:
            eps = (x - math.sqrt(bars[t]) * clean) / math.sqrt(1 - bars[t])
            x = noise_scheduler.step(eps, t, x).prev_sample
        torch.testing.assert_close(x, clean, atol=1e-3, rtol=0)

    def test_noise_is_added_in_the_variance_preserving_way(self):
        _, bars = alpha_bars()
        x, eps, t = torch.randn(5, 8, 9), torch.randn(5, 8, 9), torch.tensor([0, 3, 9, 15, 19])
        root = torch.from_numpy(np.sqrt(bars))[t, None, None]
        rest = torch.from_numpy(np.sqrt(1 - bars))[t, None, None]
        noisy = scheduler("DDPM").add_noise(x, eps, t)
        torch.testing.assert_close(noisy, (root * x + rest * eps).float(), atol=1e-5, rtol=1e-5)


def raw_batch_of(policy, n=4):
    """A training batch of random frames, as a dataset gives it."""
    rng = torch.Generator().manual_seed(0)
    observations = observation(policy, n)
    horizon = len(policy.delta_indices["action"])
    return {
        IMAGE: torch.from_numpy(observations[IMAGE]).movedim(-1, -3),
        "observation.state": torch.from_numpy(observations["observation.state"]),
        "action": torch.rand(n, horizon, 9, generator=rng) - 0.5,
        "action_is_pad": torch.zeros(n, horizon, dtype=torch.bool),
    }


def batch_of(policy):
    """A normalized training batch of random frames."""
    return policy.preprocess(raw_batch_of(policy))


class TestLosses:
    @pytest.mark.slow
    @pytest.mark.parametrize("prediction_type", ["epsilon", "sample"])
    def test_the_diffusion_loss_of_a_network_that_answers_zero(self, prediction_type, monkeypatch):
        policy = make("diffusion", prediction_type=prediction_type)
        batch = batch_of(policy)
        network = policy.model.diffusion.unet
        monkeypatch.setattr(network, "forward", lambda x, *_args, **_kwargs: torch.zeros_like(x))
        # The images' random crop would draw first.
        monkeypatch.setattr(policy.model.diffusion, "_prepare_global_conditioning", lambda _batch: None)
        policy.begin_training()
        torch.manual_seed(8)
        loss, _ = policy.loss(dict(batch))
        torch.manual_seed(8)
        noise = torch.randn(batch["action"].shape)
        expected = noise if prediction_type == "epsilon" else batch["action"]
        torch.testing.assert_close(loss, expected.square().mean())

    @pytest.mark.slow
    @pytest.mark.parametrize("use_vae", [False, True])
    def test_actions_after_the_end_of_an_episode_do_not_count_in_act(self, use_vae):
        policy = make("act", use_vae=use_vae)
        policy.begin_training()
        batch = batch_of(policy)
        batch["action_is_pad"][:, 4:] = True
        batch["action_is_pad"][1, 2:] = True

        def loss_of(changed):
            torch.manual_seed(0)
            return policy.loss(dict(batch) | {"action": changed})[0].item()

        padded = torch.where(batch["action_is_pad"][..., None], 50.0, batch["action"])
        assert loss_of(padded) == pytest.approx(loss_of(batch["action"]), rel=1e-5)
        real = batch["action"].clone()
        real[0, 3] += 5.0
        assert loss_of(real) > loss_of(batch["action"]) + 0.1

    def test_the_act_loss_is_the_mean_error_of_the_real_actions(self, monkeypatch):
        policy = make("act", use_vae=False)
        batch = batch_of(policy)
        batch["action_is_pad"][2, 1:] = True
        answer = torch.full_like(batch["action"], 0.25)
        monkeypatch.setattr(policy.model.model, "forward", lambda _batch: (answer, (None, None)))
        policy.begin_training()
        loss, terms = policy.loss(dict(batch))
        error = (batch["action"] - 0.25).abs()
        kept = torch.cat([error[:2].flatten(0, 1), error[2, :1], error[3]])
        torch.testing.assert_close(loss, kept.mean())
        assert terms == {"l1_loss": pytest.approx(kept.mean().item())}


class TestNormalization:
    def test_act_subtracts_the_mean_and_divides_by_the_deviation(self):
        own = {name: torch.from_numpy(value) for name, value in stats()["action"].items()}
        actions = torch.rand(3, 6, 9)
        batch = make("act").preprocess({"action": actions, "observation.state": torch.zeros(1, 9)})
        torch.testing.assert_close(batch["action"], (actions - own["mean"]) / own["std"])

    def test_diffusion_maps_the_limits_to_plus_and_minus_one(self):
        own = stats()["action"]
        actions = torch.tensor(np.stack([own["min"], own["max"], (own["min"] + own["max"]) / 2]))
        batch = make("diffusion").preprocess(
            {"action": actions[None], "observation.state": torch.zeros(1, 9)}
        )
        expected = torch.tensor([-1.0, 1.0, 0.0])[:, None].expand(3, 9)
        torch.testing.assert_close(batch["action"][0], expected, atol=1e-5, rtol=0)

    @pytest.mark.slow
    @pytest.mark.parametrize("name", LEARNED)
    def test_actions_come_back(self, name):
        policy = make(name)
        actions = torch.rand(3, 8, 9, generator=torch.Generator().manual_seed(1)) * 2 - 1
        normalized = policy.preprocess({"action": actions, "observation.state": torch.zeros(1, 9)})["action"]
        assert not torch.allclose(normalized, actions, atol=0.05)
        torch.testing.assert_close(policy.postprocessor(normalized), actions, atol=1e-5, rtol=0)

    def test_the_numbers_that_are_guarded(self):
        """A deviation below 0.01 counts as 0.01; a range below 1e-4 is widened by 1 to both sides."""
        given = {"mean": [0.0, 0.0], "std": [1e-6, 0.5], "min": [2.0, -1.0], "max": [2.00005, 1.0]}
        own = policy_stats({"action": False}, {"action": given}, "dataset")["action"]
        assert own["std"].tolist() == pytest.approx([0.01, 0.5])
        assert own["min"].tolist() == pytest.approx([1.0, -1.0])
        assert own["max"].tolist() == pytest.approx([3.00005, 1.0])
        assert given["std"][0] == 1e-6

    def test_flat_image_statistics_get_their_axes(self):
        given = {"mean": [0.1, 0.2, 0.3], "std": [0.0, 0.2, 0.2], "min": [0.0] * 3, "max": [1.0] * 3}
        own = policy_stats({IMAGE: True}, {IMAGE: given}, "dataset")[IMAGE]
        assert {value.shape for value in own.values()} == {(3, 1, 1)}
        assert own["std"].ravel().tolist() == pytest.approx([0.01, 0.2, 0.2])

    @pytest.mark.slow
    @pytest.mark.parametrize("name", LEARNED)
    def test_a_checkpoint_normalizes_as_its_policy_did(self, name, tmp_path):
        own = stats() | {"action": {k: v * 2 for k, v in stats()["action"].items()}}
        policy = policies.create(name, FEATURES, own, CONFIGS[name])
        policy.save(tmp_path / name)
        loaded = policies.load(tmp_path / name)
        frames = {"action": torch.rand(2, 6, 9), IMAGE: torch.rand(2, 3, SIZE, SIZE)}
        before, after = policy.preprocess(frames), loaded.preprocess(frames)
        assert all(before[key].equal(after[key]) for key in frames)

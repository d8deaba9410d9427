"""PPO from images: updates of the shared encoder, runs that resume, and what they learn."""

import pytest
import torch

pytest.importorskip("rsl_rl")
pytest.importorskip("torchrl")

import policies
from envs.core.errors import CheckpointError
from policies.ppo.config import PpoConfig
from policies.ppo.network import PixelEncoder
from roboverse_learn.config.compose import compose
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.rl.ppo import learner
from tests.roboverse_learn.training.point_mass import GOOD_RETURN, RANDOM_RETURN
from tests.roboverse_learn.training.rl.ppo.filmed import FilmedPointMass
from tests.sweeps import sweep

BACKENDS = ("rsl_rl", "torchrl")
SMALL = {"num_envs": 8, "num_steps": 4, "num_epochs": 2, "num_minibatches": 2, "hidden_dims": (16,)}


def config_of(backend: str, **changes) -> PpoConfig:
    return PpoConfig(backend=backend, observation="pixels", **(SMALL | changes))


def run(backend: str, folder, *, seed: int = 0, steps: int = 96, **changes):
    train = TrainConfig(steps=steps, save_every=64, log_every=1, num_threads=1)
    learner.train(config_of(backend, **changes), FilmedPointMass(8), train, folder, "Filmed", seed=seed)
    return policies.load(folder)


def rolled_out(backend: str, *, lr: float = 1e-3, **changes):
    """Returns an algorithm whose first rollout is full."""
    config = config_of(backend, **({"schedule": "fixed"} | changes))
    env = FilmedPointMass(8)
    algorithm = learner._agent(config, env, TrainConfig(lr=lr, grad_clip=0.0), "Filmed", 0)
    observation, first = env.reset(), torch.ones(8, dtype=torch.bool)
    torch.manual_seed(1)
    for _ in range(config.num_steps):
        action = algorithm.act(observation, first)
        step = env.step(action)
        algorithm.store(observation, action, step)
        observation, first = step.obs, step.terminated | step.truncated
    return algorithm, observation


def changes_of(backend: str, **changes) -> dict[str, torch.Tensor]:
    """Returns how far an update moves each weight, of policy and value."""
    algorithm, _ = rolled_out(backend, **changes)
    parts = {"policy": algorithm.policy.model, "critic": algorithm.critic}
    weights = {f"{name}.{key}": w for name, part in parts.items() for key, w in part.named_parameters()}
    before = {key: weight.detach().clone() for key, weight in weights.items()}
    algorithm.learn()
    return {key: weight.detach() - before[key] for key, weight in weights.items()}


@pytest.mark.parametrize("backend", BACKENDS)
def test_update_moves_every_layer_of_the_encoder(backend):
    moved = changes_of(backend)
    convolutions = [key for key in moved if key.startswith("policy.norm.images") and "weight" in key]
    assert len(convolutions) == 4  # three, and the layer after them
    assert all(change.abs().max() > 0.0 for change in moved.values())


def test_first_gradient_step_is_that_of_the_other_library():
    one = {"num_epochs": 1, "num_minibatches": 1, "num_steps": 16}
    ours, reference = (changes_of(backend, **one) for backend in BACKENDS)
    assert len(reference) == 19
    for key, change in reference.items():
        # Adam's first step is the sign of the gradient: where that is near 0, rounding decides.
        same = torch.isclose(ours[key], change, rtol=1e-2, atol=1e-6).float().mean()
        assert same > 0.97, key


def test_gradient_step_encodes_once_and_never_with_old_weights(monkeypatch):
    algorithm, observation = rolled_out("rsl_rl")
    calls, forward = [], PixelEncoder.forward

    def counted(self, seen):
        calls.append(torch.is_grad_enabled())
        return forward(self, seen)

    monkeypatch.setattr(PixelEncoder, "forward", counted)
    algorithm.learn()
    assert sum(calls) == SMALL["num_epochs"] * SMALL["num_minibatches"]
    grouped = algorithm._grouped(observation)  # the same tensor, whose value was computed before the update
    with torch.no_grad():
        assert algorithm.ppo.critic(grouped).equal(algorithm.values(observation))
        assert algorithm.ppo.actor(grouped).equal(algorithm.policy.model(observation))


def test_rollouts_are_kept_as_bytes():
    algorithm, _ = rolled_out("rsl_rl")
    (kept,) = algorithm.ppo.storage.observations.values()
    assert kept.dtype == torch.uint8 and kept.shape == (4, 8, FilmedPointMass.observation_size)


@pytest.mark.slow
@pytest.mark.parametrize("lr", [None, 1e-2])
def test_encoder_survives_the_first_rollout_at_the_rate_of_the_preset(lr, monkeypatch):
    """Rewards are less 1, as where success ends an episode. At 0.01, the largest adaptive rate, it dies."""
    step = FilmedPointMass.step

    def shifted(self, actions):
        found = step(self, actions)
        return found._replace(reward=found.reward - 1.0)

    monkeypatch.setattr(FilmedPointMass, "step", shifted)
    preset = compose("train", ["policy=ppo", "preset=pixels"])
    own = {key: getattr(preset.policy, key) for key in ("num_epochs", "num_minibatches", "gamma", "lam")}
    assert preset.policy.schedule == "fixed"
    algorithm, seen = rolled_out("rsl_rl", lr=lr or preset.train.lr, **own, num_steps=16, hidden_dims=(512,))
    algorithm.learn()
    with torch.no_grad():
        differ = algorithm.policy.model.norm(seen)[:, :256].std(0).max().item()
    assert (differ > 1e-3) == (lr is None)  # other images, other features


@pytest.mark.parametrize("backend", sweep(BACKENDS, {"rsl_rl"}))
def test_run_resumes_to_the_same_weights_and_another_seed_gives_others(backend, tmp_path):
    whole, same = (run(backend, tmp_path / name).state_dict() for name in ("whole", "same"))
    run(backend, tmp_path / "cut", steps=64)
    cut = run(backend, tmp_path / "cut").state_dict()
    other = run(backend, tmp_path / "other", seed=1).state_dict()
    for key, weight in whole.items():
        assert same[key].equal(weight) and cut[key].equal(weight), key
    assert not other["norm.images.0.weight"].equal(whole["norm.images.0.weight"])


def test_run_of_more_frames_is_not_gone_on_with(tmp_path):
    class TwoFrames(FilmedPointMass):
        observation_size = 2 * FilmedPointMass.observation_size

        def _observe(self):
            return torch.cat([super()._observe()] * 2, dim=1)

    run("rsl_rl", tmp_path)
    train = TrainConfig(steps=128, num_threads=1)
    with pytest.raises(CheckpointError, match="num_frames was 1 and is 2"):
        learner.train(config_of("rsl_rl", num_frames=2), TwoFrames(8), train, tmp_path, "Filmed")


@pytest.mark.long
@pytest.mark.parametrize("backend", BACKENDS)
def test_it_learns_from_images(backend, tmp_path):
    config = PpoConfig(
        backend=backend, observation="pixels", num_envs=16, num_steps=32, num_epochs=4, num_minibatches=4,
        hidden_dims=(64,), gamma=0.9, lam=0.9, desired_kl=0.02,
    )  # fmt: skip
    train = TrainConfig(steps=15_360, lr=1e-3, grad_clip=0.5, log_every=512, save_every=10**6)
    learner.train(config, FilmedPointMass(16), train, tmp_path, "Filmed")
    returns = [row["episode_return"] for row in read_metrics(tmp_path) if "episode_return" in row]
    assert returns[0] < RANDOM_RETURN + 3.0
    assert returns[-1] > GOOD_RETURN - 1.0

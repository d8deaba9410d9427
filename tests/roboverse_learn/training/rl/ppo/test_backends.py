"""PPO by each of the three libraries."""

import pytest
import torch

pytest.importorskip("rsl_rl")
pytest.importorskip("stable_baselines3")
pytest.importorskip("torchrl")

import policies
from envs.core.errors import CheckpointError
from policies.ppo.config import BACKENDS, PpoConfig
from policies.ppo.policy import PpoPolicy
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.divergence import TrainingDivergedError
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.rl.loop import OBSERVATION
from roboverse_learn.training.rl.ppo import learner
from tests.envs.adapters.chain import GAMMA, Chain
from tests.roboverse_learn.training.point_mass import PointMass
from tests.roboverse_learn.training.rl.ppo.reach import Reach
from tests.roboverse_learn.training.signals import SignalAt
from tests.sweeps import sweep

SMALL = {"num_envs": 8, "num_steps": 4, "num_epochs": 2, "num_minibatches": 2, "hidden_dims": (16,)}
ROLLOUT = 32


def config_of(backend: str, **changes) -> PpoConfig:
    return PpoConfig(backend=backend, **(SMALL | changes))


def optimization(**changes) -> TrainConfig:
    return TrainConfig(**({"steps": 96, "save_every": 64, "log_every": 1, "num_threads": 1} | changes))


def run(backend: str, folder, env=None, *, train=None, **kwargs):
    config = config_of(backend)
    return learner.train(config, env or Reach(8), train or optimization(), folder, "Reach", **kwargs)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_run_leaves_metrics_curves_and_a_policy_that_acts(backend, tmp_path):
    result = run(backend, tmp_path)
    assert (result.steps, result.stopped_by) == (96, "steps")
    rows = read_metrics(tmp_path)
    assert [row["step"] for row in rows] == [32, 64, 96]
    assert {"loss", "policy_loss", "value_loss", "entropy", "std", "lr"} <= rows[0].keys()
    assert result.plot is not None and result.plot.is_file()
    assert list((tmp_path / "tensorboard").iterdir())
    policy = policies.load(tmp_path)
    assert policy.task == "Reach" and policy.config.backend == backend
    actions = policy.act({OBSERVATION: torch.randn(3, 4).numpy()})
    assert actions.shape == (3, 1, 2) and (abs(actions) <= 1).all()
    assert float(policy.model.norm.count) == 96
    assert not list(tmp_path.rglob("*.pt"))


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_linear_rate_falls_evenly_to_the_end_of_the_run(backend, tmp_path):
    config, train = config_of(backend, schedule="linear"), optimization(lr=1e-3)
    learner.train(config, Reach(8), train, tmp_path, "Reach")
    # 24, 56 and 88 of 96 steps are over at the last step before each of the three updates.
    rates = [row["lr"] for row in read_metrics(tmp_path)]
    assert rates == pytest.approx([1e-3 * 72 / 96, 1e-3 * 40 / 96, 1e-3 * 8 / 96])


def test_nothing_is_left_outside_the_run_folder(tmp_path, monkeypatch):
    temporary, folder = tmp_path / "temporary", tmp_path / "run"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    monkeypatch.chdir(temporary)
    run("sb3", folder, train=optimization(steps=32))  # its own logger makes a folder, even to write nothing
    assert (folder / "metrics.jsonl").is_file() and not list(temporary.iterdir())


@pytest.mark.parametrize("backend", sweep(BACKENDS, {"rsl_rl"}))
def test_run_resumes_where_it_stopped(backend, tmp_path):
    run(backend, tmp_path, train=optimization(steps=64))
    before = policies.load(tmp_path).state_dict()
    result = run(backend, tmp_path, train=optimization(steps=128))
    assert result.steps == 128
    after = policies.load(tmp_path).state_dict()
    assert float(after["norm.count"]) == float(before["norm.count"]) * 2 == 128
    assert [row["step"] for row in read_metrics(tmp_path)] == [32, 64, 96, 128]


@pytest.mark.parametrize("backend", sweep(BACKENDS, {"rsl_rl"}))
def test_signal_ends_a_run_after_the_rollout_and_it_resumes_identically(backend, tmp_path):
    def train(folder, **kwargs):
        run(backend, folder, PointMass(8), train=optimization(steps=320, save_every=256), **kwargs)
        return policies.load(folder).state_dict()

    whole, reporter = train(tmp_path / "whole"), SignalAt(104)
    with pytest.raises(KeyboardInterrupt, match="SIGTERM"):
        train(tmp_path / "cut", reporter=reporter)
    assert reporter.checkpoints == [128]
    resumed = train(tmp_path / "cut")
    assert all(value.equal(resumed[key]) for key, value in whole.items())


def test_a_run_of_another_task_or_backend_is_not_gone_on_with(tmp_path):
    run("torchrl", tmp_path)
    with pytest.raises(CheckpointError, match=r"Cannot resume from .*backend was torchrl and is rsl_rl"):
        run("rsl_rl", tmp_path)
    with pytest.raises(CheckpointError, match="task was Reach and is Other"):
        learner.train(config_of("torchrl"), Reach(8), optimization(), tmp_path, "Other")


@pytest.mark.parametrize("backend", sweep(BACKENDS, {"rsl_rl"}))
def test_a_run_that_diverges_stops_and_keeps_the_last_checkpoint(backend, tmp_path):
    env = Reach(8, breaks_after=10)  # in the third rollout
    message = f"not finite at update 3 of backend={backend}, at env.* The last checkpoint in .* is sound"
    with pytest.raises(TrainingDivergedError, match=message):
        run(backend, tmp_path, env, train=optimization(steps=320))
    policy = policies.load(tmp_path)
    assert all(value.isfinite().all() for value in policy.state_dict().values())
    assert (tmp_path / "checkpoints" / "last").resolve().name == "000064"


@pytest.mark.parametrize(("backend", "lr"), [("sb3", 1e20), *((name, 1e30) for name in BACKENDS)])
def test_diverged_update_is_reported(backend, lr, tmp_path):
    message = r"(is not finite|is nan|is inf).* No checkpoint had been saved"
    with pytest.raises(TrainingDivergedError, match=message):
        run(backend, tmp_path, train=optimization(steps=320, lr=lr))


@pytest.mark.parametrize("backend", BACKENDS)
def test_equal_seeds_begin_with_equal_networks(backend):
    def first(name, seed):
        torch.manual_seed(seed)
        policy = PpoPolicy(config_of(name), {OBSERVATION: 4}, 2)
        learner.make_algorithm(policy, Reach(8), optimization())
        return policy.state_dict()

    ours, same, other = first(backend, 1), first("torchrl", 1), first(backend, 2)
    assert all(torch.equal(ours[key], same[key]) for key in ours)
    assert not torch.equal(ours["layers.0.weight"], other["layers.0.weight"])


def estimates(backend: str, env: Chain, lam: float) -> torch.Tensor:
    """Returns (T, N) that a backend estimates with an exact critic."""
    config = config_of(backend, num_envs=4, num_steps=6, num_minibatches=1, gamma=GAMMA, lam=lam)
    torch.manual_seed(0)
    policy = PpoPolicy(config, {OBSERVATION: 2}, 1)
    algorithm = learner.make_algorithm(policy, env, optimization(lr=1e-9))
    values = torch.tensor([1.0, GAMMA]) / (1 - GAMMA**2)
    with torch.no_grad():  # of a constant and what is left over
        for layer in algorithm.critic[:-1]:
            if hasattr(layer, "weight"):
                layer.weight.zero_()
                layer.weight[:2] = 10.0 * torch.eye(2)
                layer.bias.zero_()
        algorithm.critic[-1].weight.zero_()
        algorithm.critic[-1].weight[0, :2] = values / (10.0 / 1.01)  # ELU passes what is above 0
        algorithm.critic[-1].bias.zero_()
    observation, first = env.reset(), torch.ones(4, dtype=torch.bool)
    kept = {}
    monkey = algorithm.update

    def spy():
        if backend == "rsl_rl":
            algorithm.ppo.compute_returns(algorithm._last)
            kept["returns"] = algorithm.ppo.storage.returns[..., 0].clone()
        elif backend == "torchrl":
            rollout = torch.stack(algorithm._steps, dim=1)
            with torch.no_grad():
                kept["returns"] = algorithm.gae(rollout)["value_target"][..., 0].T
        else:
            last = algorithm.values(algorithm._last)[:, 0].detach()
            algorithm._buffer.compute_returns_and_advantage(last, algorithm._over)
            kept["returns"] = torch.from_numpy(algorithm._buffer.returns.copy())
        return monkey()

    algorithm.update = spy
    for _ in range(6):
        action = algorithm.act(observation, first)
        step = env.step(action)
        algorithm.store(observation, action, step)
        observation, first = step.obs, step.terminated | step.truncated
    algorithm.learn()
    return kept["returns"]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("horizon", [1, 2, 3])
def test_what_is_cut_off_is_bootstrapped_by_its_last_observation(backend, horizon):
    returns = estimates(backend, Chain(4, horizon), 0.5)
    of_a, of_b = 1 / (1 - GAMMA**2), GAMMA / (1 - GAMMA**2)
    expected = torch.tensor([of_b if step % horizon % 2 else of_a for step in range(6)])
    torch.testing.assert_close(returns, expected[:, None].expand(6, 4), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_has_ended_is_not_bootstrapped(backend):
    returns = estimates(backend, Chain(4, 3, terminates=True), 1.0)
    expected = torch.tensor([1 + GAMMA**2, GAMMA, 1.0] * 2)
    torch.testing.assert_close(returns, expected[:, None].expand(6, 4), rtol=1e-4, atol=1e-4)


@pytest.mark.long
@pytest.mark.parametrize("backend", BACKENDS)
def test_it_learns(backend, tmp_path):
    config = PpoConfig(
        backend=backend, num_envs=64, num_steps=32, num_epochs=4, num_minibatches=4, hidden_dims=(64, 64),
        gamma=0.97, lam=0.95,
    )  # fmt: skip
    train = TrainConfig(steps=60_000, lr=1e-3, grad_clip=1.0, log_every=10_000, save_every=60_000)
    learner.train(config, Reach(64), train, tmp_path, "Reach")
    assert read_metrics(tmp_path)[-1]["success_rate"] > 0.95

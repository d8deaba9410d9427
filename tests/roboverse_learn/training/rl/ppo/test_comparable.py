"""Equal hyperparameters: the three libraries make the same first update, and learn alike."""

import numpy as np
import pytest
import torch

pytest.importorskip("rsl_rl")
pytest.importorskip("stable_baselines3")
pytest.importorskip("torchrl")

from policies.ppo.config import BACKENDS, PpoConfig
from policies.ppo.policy import PpoPolicy
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.rl.loop import OBSERVATION
from roboverse_learn.training.rl.ppo import learner
from tests.roboverse_learn.training.rl.ppo.reach import Reach

EQUAL = {"num_steps": 16, "schedule": "fixed", "hidden_dims": (32, 32), "gamma": 0.97, "lam": 0.95}


def first_update(backend: str, done: float = 0.0, **changes) -> dict[str, torch.Tensor]:
    """Returns how far the weights move in one gradient step on the same rollout, a share of the run done."""
    values = EQUAL | {"num_envs": 32, "num_epochs": 1, "num_minibatches": 1} | changes
    env, config = Reach(32), PpoConfig(backend=backend, **values)
    torch.manual_seed(0)
    policy = PpoPolicy(config, {OBSERVATION: 4}, 2)
    algorithm = learner.make_algorithm(policy, env, TrainConfig(lr=1e-3, grad_clip=0.0))
    before = {key: value.clone() for key, value in policy.state_dict().items()}
    algorithm.set_progress(done)
    observation, first = env.reset(), torch.ones(32, dtype=torch.bool)
    torch.manual_seed(1)
    for _ in range(16):
        action = algorithm.act(observation, first)
        step = env.step(action)
        algorithm.store(observation, action, step)
        observation, first = step.obs, step.terminated | step.truncated
    algorithm.learn()
    after = policy.state_dict()
    return {key: after[key] - before[key] for key in before if not key.startswith("norm")}


@pytest.mark.parametrize("backend", ["sb3", "torchrl"])
def test_the_first_gradient_step_is_the_same(backend):
    ours, reference = first_update(backend), first_update("rsl_rl")
    assert all((change != 0).any() for change in reference.values())
    for key, change in reference.items():
        # Adam's first step is the sign of the gradient: where that is near 0, rounding decides.
        same = torch.isclose(ours[key], change, rtol=1e-2, atol=1e-6).float().mean()
        assert same > 0.98, key


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_linear_rate_makes_a_gradient_step_as_much_smaller(backend):
    whole = first_update(backend)
    quarter = first_update(backend, done=0.75, schedule="linear")
    for key, change in whole.items():
        torch.testing.assert_close(quarter[key], change / 4, rtol=1e-3, atol=1e-8)


@pytest.mark.long
def test_curves_of_equal_hyperparameters_are_alike(tmp_path):
    config = EQUAL | {"num_envs": 64, "num_epochs": 4, "num_minibatches": 4}
    train = TrainConfig(
        steps=16 * 1024, lr=1e-3, grad_clip=1.0, log_every=4096, save_every=10**9, num_threads=1
    )
    ends = {}
    for backend in BACKENDS:
        learner.train(PpoConfig(backend=backend, **config), Reach(64), train, tmp_path / backend, "Reach")
        rows = read_metrics(tmp_path / backend)
        assert [row["step"] for row in rows] == [4096, 8192, 12288, 16384]
        ends[backend] = [row["episode_return"] for row in rows]
    first, last = (np.array([curve[at] for curve in ends.values()]) for at in (0, -1))
    assert (last > first + 5.0).all()  # every one of them learns, from about -30
    assert last.max() - last.min() < 0.25 * (last - first).mean()  # and they end near each other

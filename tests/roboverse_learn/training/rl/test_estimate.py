"""How long learning in an env will take: timed in another env, and reported before the run begins."""

import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError
from policies.fasttd3.config import FastTd3Config
from policies.ppo.config import PpoConfig
from policies.tdmpc2.config import Tdmpc2Config
from roboverse_learn.config.compose import compose
from roboverse_learn.train import refuse_long_run, train
from roboverse_learn.training.learners import learner_of
from roboverse_learn.training.reporter import Reporter
from roboverse_learn.training.rl import estimate
from roboverse_learn.training.rl.fasttd3 import FastTd3Learner
from roboverse_learn.training.rl.ppo.learner import PpoLearner
from roboverse_learn.training.rl.tdmpc2 import Tdmpc2Learner
from tests.sweeps import sweep

pytestmark = pytest.mark.slow

SMALL = {
    "ppo": ("rsl_rl", "policy.num_envs=8 policy.num_steps=4 policy.num_minibatches=2 policy.hidden_dims=[8]"),
    "tdmpc2": ("torchrl", "policy.num_envs=4 policy.batch_size=8 policy.num_samples=16 policy.seed_steps=32"),
    "fasttd3": ("torch", "policy.num_envs=4 policy.batch_size=16 policy.actor_dim=16 policy.critic_dim=16"),
}
"""Policy to the package that it needs and to words that make it small."""


def small(policy: str, *words: str) -> Any:
    package, sizes = SMALL[policy]
    pytest.importorskip(package)
    return compose(
        "train",
        [f"policy={policy}", "preset=quick", "task=control/cartpole", "device=cpu", "train.time_limit_s=null",
         "train.steps=64", *sizes.split(), *words],
    )  # fmt: skip


@pytest.mark.parametrize("policy", sweep(SMALL, {"fasttd3"}))
def test_a_long_run_of_an_agent_is_reported_before_it_has_a_folder(policy: str, tmp_path: Path) -> None:
    folders = [f"{key}={tmp_path / key}" for key in ("runs_dir", "results_dir")]
    with pytest.raises(ConfigError, match=r"about .* days on this machine's CPU.*preset=quick.*slow_ok=true"):
        train(replace(small(policy, "train.steps=1000000000000", *folders), preset="full"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("policy", SMALL)
def test_a_short_run_of_an_agent_begins(policy: str, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO"):
        refuse_long_run(learner_of(small(policy), "cpu"))
    assert f"Timing policy={policy} on this machine." in caplog.messages
    assert caplog.messages[-1] == "Training will take about 1 minute."


@pytest.mark.parametrize("policy", sweep(SMALL, {"fasttd3"}))
def test_an_agent_learns_the_same_whether_it_was_timed_or_not(policy: str, tmp_path: Path) -> None:
    config, before = small(policy), _random()
    for name in ("plain", "timed"):
        if name == "timed":
            learner_of(config, "cpu").estimate_s()
            assert _random() == before
        learner_of(config, "cpu").learn(tmp_path / name, None, 3, Reporter())
    plain, timed = (
        tmp_path / name / "checkpoints" / "last" / "pretrained_model" / "model.safetensors"
        for name in ("plain", "timed")
    )
    assert plain.read_bytes() == timed.read_bytes()


def _random() -> tuple[Any, ...]:
    return torch.get_rng_state().tolist(), random.getstate(), np.random.get_state()[1].tolist()


def test_the_clock_ends_a_run_that_is_estimated_as_longer() -> None:
    config = small("fasttd3", "train.steps=1000000000000", "train.time_limit_s=5000")
    assert learner_of(config, "cpu").estimate_s() == 5000.0


class Clocked:
    """Four environments whose steps take 2 s each; every third one makes an update of 3 s due."""

    def __init__(self, period: int = 3) -> None:
        self.now, self.step, self.updates, self.period = 100.0, 0, 0, period

    def advance(self) -> None:
        self.step, self.now = self.step + 4, self.now + 2.0
        if self.step // 4 % self.period == 0:
            self.updates, self.now = self.updates + 1, self.now + 3.0


@pytest.mark.parametrize("least_s", [0.0, 9.5])
def test_what_is_timed_ends_with_an_update(least_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    loop = Clocked()
    monkeypatch.setattr(estimate.time, "perf_counter", lambda: loop.now)
    assert estimate._advance(loop, least_s) == (3 * 2.0 + 3.0) / (3 * 4)
    assert loop.updates == (2 if least_s else 1)


def test_an_update_that_is_far_off_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = Clocked(period=1000)
    monkeypatch.setattr(estimate.time, "perf_counter", lambda: loop.now)
    assert estimate._advance(loop, 1.0) == 2.0 / 4
    assert loop.now == 100.0 + estimate._MOST_TIMED_S


def test_large_agents_are_timed_by_small_ones() -> None:
    timed = FastTd3Learner.brief(FastTd3Config(num_envs=1024, batch_size=32_768))
    assert (timed.num_envs, timed.batch_size, timed.learning_starts) == (32, 1024, 0)
    timed = FastTd3Learner.brief(FastTd3Config(num_envs=64, batch_size=1000))
    assert (timed.num_envs, timed.batch_size) == (64, 1000)
    timed = FastTd3Learner.brief(FastTd3Config(num_envs=1, batch_size=32_768))
    assert (timed.num_envs, timed.batch_size) == (1, 32_768)
    assert Tdmpc2Learner.brief(Tdmpc2Config(num_envs=64, update_ratio=0.125)).num_envs == 8
    timed = PpoLearner.brief(PpoConfig(num_envs=4096, num_steps=9, num_minibatches=9, expert_starts=0.5))
    assert (timed.num_envs, timed.num_steps, timed.num_minibatches) == (135, 8, 9)
    assert timed.expert_starts == 0.0  # whose states take longer to draw than steps to time
    few = PpoConfig(num_envs=5, num_steps=9, num_minibatches=3)
    assert PpoLearner.brief(few) == few

"""Policies that learn from an env: how the main command finds what trains them."""

from pathlib import Path
from types import SimpleNamespace

import pytest

import policies
from envs.core.errors import ConfigError, UnknownNameError
from roboverse_learn import train as command
from roboverse_learn.config.compose import compose
from roboverse_learn.training.reporter import Reporter
from roboverse_learn.training.rl import learners


def learn(config, run_dir, device, seed, reporter):
    """Stands in for a learner."""
    return SimpleNamespace(checkpoint=run_dir, config=config, device=device, seed=seed, reporter=reporter)


def test_every_policy_that_learns_from_an_env_has_a_learner():
    assert sorted(learners.LEARNERS) == policies.names("env")
    assert policies.names() == sorted(policies.names("env") + policies.names("dataset"))
    assert policies.learns_from("act") == "dataset"
    for name in policies.names("env"):
        assert callable(learners.learner_of(name))


def test_a_learner_is_given_the_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setitem(learners.LEARNERS, "act", __name__)
    config = compose("train", ["seed=3"])
    result = command._learn(config, tmp_path, "cpu")
    assert (result.checkpoint, result.config, result.device) == (tmp_path, config, "cpu")
    assert isinstance(result.reporter, Reporter)
    assert result.seed == command._learn(config, tmp_path, "cpu").seed
    assert result.seed != command._learn(compose("train", ["seed=4"]), tmp_path, "cpu").seed


def test_an_unknown_learner_is_an_error():
    with pytest.raises(UnknownNameError, match="Unknown policy that learns from an env 'act'"):
        learners.learner_of("act")


def test_several_processes_are_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(learners.LEARNERS, "act", __name__)
    monkeypatch.setenv("WORLD_SIZE", "2")
    with pytest.raises(ConfigError, match="policy=act learns in one process; start it without `accelerate"):
        learners.learner_of("act")

"""Contracts of policies: ours keep them, and each finds the mistake that it is for."""

import re
from dataclasses import dataclass

import pytest
import torch
from torch import nn

import policies
from envs.core.errors import ConfigError
from envs.spec import EnvSpec
from policies.trainable import TrainablePolicy
from roboverse_learn.checks.contract import chosen, run
from roboverse_learn.checks.policies import POLICY_CONTRACTS, CheckedPolicy
from tests.policies.examples import LEARNED, NARROW_CONFIGS

SPEC = EnvSpec(image_size=32)


@pytest.mark.long
@pytest.mark.parametrize("name", LEARNED)
def test_every_policy_that_learns_from_demonstrations_keeps_its_contracts(name):
    findings = list(run(POLICY_CONTRACTS, CheckedPolicy(name, SPEC, NARROW_CONFIGS[name])))
    assert [finding for finding in findings if finding.result != "ok"] == []


def test_a_policy_that_learns_otherwise_is_refused():
    with pytest.raises(ConfigError, match=r"policy=ppo does not learn from demonstrations.* act, diffusion"):
        CheckedPolicy("ppo", SPEC)


@dataclass(frozen=True, kw_only=True)
class SmallConfig:
    chunk_size: int = 4


class Small(TrainablePolicy):
    config_class = SmallConfig

    def __init__(self, config, shapes):
        super().__init__(config, shapes)
        (state,), (action,) = shapes["observation.state"], shapes["action"]
        self.hidden = nn.Sequential(nn.Linear(state, 64), nn.ReLU())
        self.head = nn.Sequential(nn.Linear(64, 4 * action), nn.Unflatten(1, (4, action)))

    def compute_loss(self, batch):
        return (self.act(batch) - batch["action"]).square().mean()

    def act(self, observation):
        return self.head(self.hidden(observation["observation.state"]))


class Good(Small):
    """Keeps every contract."""


class NotANumber(Small):
    def act(self, observation):
        return super().act(observation) * torch.nan


class Counting(Small):
    calls = 0

    def act(self, observation):
        self.calls += 1
        return super().act(observation) + self.calls


class Forgetful(Small):
    """What it learned is in no parameter."""

    def __init__(self, config, shapes):
        super().__init__(config, shapes)
        self.scale = torch.rand(1)  # no buffer

    def act(self, observation):
        return super().act(observation) + self.scale


class Unteachable(Small):
    def compute_loss(self, batch):
        return super().compute_loss(batch) * 0.0 + 1.0


@pytest.mark.parametrize(
    ("cls", "contract", "message"),
    [
        (Good, "learns", None),
        (NotANumber, "acts", "actions that are not finite"),
        (Counting, "repeatable", "two answers for one observation and one seed. Keep nothing between calls"),
        (Forgetful, "saved_and_loaded", "loaded policy acts differently. Keep what it learns in parameters"),
        (Unteachable, "learns", r"The loss of one batch of 4 fell from 1 to 1 only in 100 steps"),
    ],
)
def test_a_broken_policy_is_found(monkeypatch, cls, contract, message):
    monkeypatch.setattr(policies.POLICIES, "_entries", dict(policies.POLICIES._entries))
    policies.POLICIES.add("mine", cls, summary="mine")
    findings = list(run(chosen(POLICY_CONTRACTS, [contract]), CheckedPolicy("mine", SPEC)))
    if message is None:
        assert {finding.result for finding in findings} == {"ok"}
    else:
        assert findings[-1].result == "failed"
        assert re.search(message, findings[-1].detail), findings[-1].detail

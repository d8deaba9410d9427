"""A fast form of a loss with other gradients than eager code's is not trained with."""

import logging
from dataclasses import replace

import pytest
import torch
from torch import nn

from roboverse_learn.training import fast_objective as module
from roboverse_learn.training.fast_objective import fast_objective, first_disagreement
from roboverse_learn.training.imitation import train
from tests.roboverse_learn.training.test_imitation import CONFIG, DATA, make


class Line(nn.Module):
    """y = a x + b after a batch normalization, and the loss of it."""

    def __init__(self):
        super().__init__()
        self.norm = nn.BatchNorm1d(1, affine=False)
        self.a, self.b = nn.Parameter(torch.tensor(2.0)), nn.Parameter(torch.tensor(-1.0))


class Loss(nn.Module):
    """Mean squares of the line, with what a compiler's fault does to the gradients from a call on."""

    def __init__(self, line, fault=None, since=0):
        super().__init__()
        self.line, self.fault, self.since, self.calls = line, fault, since, 0

    def forward(self, batch):
        slope = self.line.a
        if self.fault is not None and self.calls >= self.since:
            slope = _Faulty.apply(slope, self.fault)
        self.calls += 1
        loss = (self.line.norm(batch["x"]) * slope + self.line.b).square().mean()
        return loss, {"mse": loss.detach()}


class _Faulty(torch.autograd.Function):
    """The identity, whose gradient is multiplied by a factor."""

    @staticmethod
    def forward(ctx, value, factor):
        ctx.factor = factor
        return value.clone()

    @staticmethod
    def backward(ctx, gradient):
        return gradient * ctx.factor, None


def batches(n=3):
    rng = torch.Generator().manual_seed(0)
    return [{"x": torch.randn(16, 1, generator=rng)} for _ in range(n)]


def disagreement(fault, since=0, precision="fp32"):
    line = Line()
    return first_disagreement(line, Loss(line), Loss(line, fault, since), batches(), precision, "cpu")


def test_equal_gradients_agree_in_both_precisions():
    assert disagreement(1.0) is None
    assert disagreement(1.0, precision="bf16") is None
    assert disagreement(1.02) is None, "this is rounding"


@pytest.mark.parametrize("fault", [0.0, 1.2, -1.0, float("nan"), float("inf")])
@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_a_wrong_gradient_is_named(fault, precision):
    found = disagreement(fault, precision=precision)
    assert found.parameter == "a"
    assert found.error == pytest.approx(abs(fault - 1.0), rel=0.1, nan_ok=True)
    assert 0.04 < found.allowed < 0.2


def test_a_fault_that_begins_after_the_first_batch_is_seen():
    assert disagreement(float("nan"), since=2).parameter == "a"


def test_nothing_of_the_comparison_is_left_in_the_network():
    line = Line()
    before = {name: value.clone() for name, value in line.state_dict().items()}
    first_disagreement(line, Loss(line), Loss(line), batches(), "fp32", "cpu")
    assert line.a.grad is None and line.b.grad is None
    assert all(torch.equal(value, before[name]) for name, value in line.state_dict().items())


def test_a_policy_whose_compiled_gradients_are_wrong_is_trained_without_the_compiler(
    tmp_path, monkeypatch, caplog
):
    def compile_wrongly(objective):
        given = objective.forward

        def forward(batch):
            loss, terms = given(batch)
            return loss * 2.0 - loss.detach(), terms  # the loss is right, its gradient is twice what it is

        objective.forward = forward

    monkeypatch.setattr(module, "compile_objective", compile_wrongly)
    with caplog.at_level(logging.WARNING):
        wrong = train(make("act"), DATA, replace(CONFIG, compile=True), tmp_path / "a")
    assert "changes the gradient of '" in caplog.text
    assert "of policy=act by 100 %, where 6 % is rounding: training goes on without it" in caplog.text
    plain = train(make("act"), DATA, CONFIG, tmp_path / "b")
    assert wrong.loss == plain.loss, "the batches that were looked at are trained with all the same"


def test_a_policy_whose_compiled_gradients_are_right_is_trained_compiled(monkeypatch, caplog):
    compiled = []
    monkeypatch.setattr(module, "compile_objective", compiled.append)
    policy = make("act")
    policy.begin_training()
    sample = [DATA.sample([0, 1, 2], policy.delta_indices, keys=list(policy.features)) for _ in range(2)]
    chosen = fast_objective(policy, sample, "fp32", compile=True, cuda_graphs=False)
    assert chosen is compiled[0]
    assert not caplog.records


@pytest.mark.parametrize("fault", [1.0, 2.0])
def test_a_recording_whose_gradients_are_wrong_leaves_what_it_recorded(monkeypatch, caplog, fault):
    class Recording(nn.Module):
        def __init__(self, objective, batch, precision):
            super().__init__()
            self.objective, self.shapes, self.precision = objective, batch.keys(), precision

        def forward(self, batch):
            loss, terms = self.objective(batch)
            return fault * loss - (fault - 1.0) * loss.detach(), terms

    compiled = []
    monkeypatch.setattr(module, "compile_objective", compiled.append)
    monkeypatch.setattr(module, "RecordedObjective", Recording)
    policy = make("act")
    policy.begin_training()
    sample = [DATA.sample([0, 1, 2], policy.delta_indices, keys=list(policy.features)) for _ in range(2)]
    chosen = fast_objective(policy, sample, "fp32", compile=True, cuda_graphs=True)
    if fault == 1.0:
        assert chosen.objective is compiled[0] and chosen.precision == "fp32"
        assert not caplog.records
    else:
        assert chosen is compiled[0]
        assert "A CUDA graph of PyTorch" in caplog.text
        assert "train.cuda_graphs=false does not try." in caplog.text

"""A fast form of a loss with other gradients than eager code's is not trained with."""

import logging
from dataclasses import replace

import pytest
import torch
from torch import nn

from roboverse_learn.training.imitation import fast_objective as module
from roboverse_learn.training.imitation.fast_objective import EagerGradients, fast_objective
from roboverse_learn.training.imitation.train import train
from tests.roboverse_learn.training.imitation.test_train import CONFIG, DATA, make


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
    expected = EagerGradients(line, Loss(line), batches(), precision)
    return expected.first_disagreement(Loss(line, fault, since))


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
    assert EagerGradients(line, Loss(line), batches(), "fp32").first_disagreement(Loss(line)) is None
    assert line.a.grad is None and line.b.grad is None
    assert all(torch.equal(value, before[name]) for name, value in line.state_dict().items())


@pytest.mark.slow
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
    assert "of policy=act by 100 %, where 6 % is rounding: training continues without, more" in caplog.text
    assert "train.compile=false does not try." in caplog.text
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "chosen", "said"),
    [
        ((), "compiled and recorded", []),
        (("compiled and recorded",), "recorded", ["train.compile=true and train.cuda_graphs=true"]),
        (
            ("compiled and recorded", "recorded"),
            "compiled",
            ["train.compile=true and train.cuda_graphs=true", "train.cuda_graphs=true"],
        ),
        (
            ("compiled and recorded", "recorded", "compiled"),
            "eager",
            ["train.compile=true and train.cuda_graphs=true", "train.cuda_graphs=true", "train.compile=true"],
        ),
    ],
)
def test_the_fastest_form_with_right_gradients_is_chosen(monkeypatch, caplog, wrong, chosen, said):
    class Recording(nn.Module):
        def __init__(self, objective, batch, precision):
            super().__init__()
            self.objective, self.precision = objective, precision

        def forward(self, batch):
            return self.objective(batch)

    def name(form):
        inner = getattr(form, "objective", form)
        kinds = [
            kind
            for kind, is_it in (("compiled", inner in compiled), ("recorded", inner is not form))
            if is_it
        ]
        return " and ".join(kinds) or "eager"

    gradients = module._gradients

    def faulty(model, objective, batch, precision, seed):
        given = gradients(model, objective, batch, precision, seed)
        return {key: 2.0 * value if name(objective) in wrong else value for key, value in given.items()}

    compiled = []
    monkeypatch.setattr(module, "compile_objective", compiled.append)
    monkeypatch.setattr(module, "RecordedObjective", Recording)
    monkeypatch.setattr(module, "_gradients", faulty)
    policy = make("act")
    policy.begin_training()
    sample = [DATA.sample([0, 1, 2], policy.delta_indices, keys=list(policy.features)) for _ in range(2)]
    assert name(fast_objective(policy, sample, "fp32", compile=True, cuda_graphs=True)) == chosen
    for record, keys in zip(caplog.records, said, strict=True):
        assert record.getMessage().startswith(f"With {keys} PyTorch ")

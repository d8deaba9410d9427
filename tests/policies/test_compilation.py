"""Which options a loss is compiled with."""

import pytest
import torch
from torch import nn

from policies.compilation import (
    OBJECTIVE_OPTIONS,
    UNFUSED_OBJECTIVE_OPTIONS,
    compile_objective,
)
from tests.policies.examples import make


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes", "expected"),
    [
        ("act", {"backbone_norm": "batch"}, UNFUSED_OBJECTIVE_OPTIONS),
        ("act", {"backbone_norm": "frozen"}, OBJECTIVE_OPTIONS),
        ("diffusion", {}, OBJECTIVE_OPTIONS),
        ("diffusion", {"vision_backbone": "keypoints"}, OBJECTIVE_OPTIONS),
    ],
)
def test_only_a_trained_batch_normalization_forbids_fusion(monkeypatch, name, changes, expected):
    given = {}
    monkeypatch.setattr(nn.Module, "compile", lambda self, **words: given.update(words))
    policy = make(name, **changes)
    policy.begin_training()
    compile_objective(policy.objective())
    assert given == {"fullgraph": True, "dynamic": False, "options": expected}
    assert UNFUSED_OBJECTIVE_OPTIONS["max_fusion_size"] == 1
    assert "max_fusion_size" not in OBJECTIVE_OPTIONS


class Halves(nn.Module):
    """A loss whose first layer computes in autocast's precision and its second in float32."""

    def __init__(self):
        super().__init__()
        self.rough, self.exact = nn.Linear(64, 64), nn.Linear(64, 64)

    def forward(self, x):
        y = self.rough(x)
        with torch.autocast("cpu", enabled=False):
            return self.exact(y.float()).square().mean()


@pytest.mark.slow
@pytest.mark.filterwarnings("default::DeprecationWarning")  # the compiler's own
def test_under_autocast_what_computes_in_float32_has_gradients_in_float32():
    torch.manual_seed(0)
    loss, x = Halves(), torch.randn(256, 64)
    gradients = []
    for compiled in (False, True):
        if compiled:
            compile_objective(loss)
        loss.zero_grad()
        with torch.autocast("cpu", torch.bfloat16):
            value = loss(x)
        value.backward()
        gradients.append(loss.exact.weight.grad.clone())
    error = (gradients[1] - gradients[0]).norm() / gradients[0].norm()
    assert error < 1e-5  # 3e-3 in bfloat16

"""Which options a loss is compiled with."""

import pytest
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

"""What is done around a recording; tests/gpu/test_losses.py shows that it plays back."""

import pytest
import torch
from torch import nn

from policies.cuda_graphs import RecordedObjective


class Loss(nn.Module):
    def __init__(self):
        super().__init__()
        self.norm = nn.BatchNorm1d(2)

    def forward(self, batch):
        loss = self.norm(batch["x"]).square().sum()
        return loss, {"squares": loss.detach()}


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_a_recording_leaves_running_statistics_and_the_batch(monkeypatch, precision):
    seen = []

    def record(module, arguments, *, allow_unused_input):
        (sample,) = arguments
        seen.append((torch.is_autocast_enabled("cpu"), torch.is_autocast_cache_enabled(), sample))
        assert allow_unused_input, "a network may have weights that a loss does without"
        module(sample)
        sample["x"].zero_()  # where later batches are put

    monkeypatch.setattr(torch.cuda, "make_graphed_callables", record)
    objective, batch = Loss(), {"x": torch.randn(8, 2)}
    before, images = {k: v.clone() for k, v in objective.state_dict().items()}, batch["x"].clone()
    recording = RecordedObjective(objective, batch, precision)
    assert seen[0][:2] == (precision == "bf16", False)
    assert torch.equal(batch["x"], images)
    assert all(torch.equal(value, before[name]) for name, value in objective.state_dict().items())
    loss, terms = recording(batch)
    assert loss.item() == pytest.approx(16.0, rel=1e-2), "8 samples of 2 normalized numbers"
    assert terms.keys() == {"squares"}
    assert set(recording.parameters()) == set(objective.parameters())

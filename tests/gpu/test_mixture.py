"""Batches of several datasets on a GPU, of which some stay in main memory."""

import numpy as np
import pytest
import torch

from roboverse_learn.data import ResidentDataset
from roboverse_learn.data.dataset import reader
from roboverse_learn.data.dataset.mixture import Mixture
from tests.roboverse_learn.data.two_tasks import write

pytestmark = pytest.mark.gpu

IMAGE = "observation.images.front"
KEYS = [IMAGE, "observation.state", "action", "task_index"]
WINDOWS = {"action": range(4), IMAGE: [-1, 0]}


@pytest.fixture
def folders(tmp_path):
    return {"Right": write(tmp_path / "right", "Right", 6), "Left": write(tmp_path / "left", "Left", 2)}


@pytest.mark.parametrize("stay", [(), ("Left",), ("Left", "Right")])
def test_batches_are_those_of_a_cpu(folders, monkeypatch, stay):
    monkeypatch.setattr(reader, "TRAINING_BYTES", 10**15)
    parts = [
        ResidentDataset(root, device="cuda", memory_fraction=1e-12 if name in stay else 0.5)
        for name, root in folders.items()
    ]
    assert [part.frames[IMAGE].is_cuda for part in parts] == [name not in stay for name in folders]
    assert all(part.frames["action"].is_cuda for part in parts)
    on_gpu, on_cpu = Mixture(parts, list(folders)), Mixture.open(folders, "cpu")
    rng = np.random.default_rng(0)
    for indices in (np.arange(40), rng.integers(0, 40, 16), rng.integers(30, 40, 3)):
        found = on_gpu.sample(indices, WINDOWS, keys=KEYS)
        expected = on_cpu.sample(indices, WINDOWS, keys=KEYS)
        assert found.keys() == expected.keys()
        for key, values in expected.items():
            assert found[key].is_cuda and torch.equal(found[key].cpu(), values), key

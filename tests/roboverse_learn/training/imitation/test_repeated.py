"""Two fresh trainings, each in a process of its own."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[4]

_TRAIN = f"""
import sys, types
sys.modules["tests"] = types.ModuleType("tests")  # a package of this name may be installed
sys.modules["tests"].__path__ = [{str(ROOT / "tests")!r}]
from dataclasses import replace
from tests.roboverse_learn.training.imitation.test_train import CONFIG, DATA, make, train
settings = dict(act=dict(dropout=0.1), diffusion=dict())[sys.argv[1]]
config = replace(CONFIG, steps=4, save_every=4, ema=True, num_threads=2, batch_size=32)
train(make(sys.argv[1], **settings), DATA, config, sys.argv[2])
"""


@pytest.mark.parametrize("name", ["act", "diffusion"])
def test_two_fresh_trainings_of_two_threads_end_with_the_same_weights(name, tmp_path):
    """Whatever the hashes of the process: both run side by side and share the cores."""
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", _TRAIN, name, tmp_path / seed],
            cwd=ROOT,
            env=os.environ | {"PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)},
        )
        for seed in ("1", "2")
    ]
    assert [process.wait(timeout=300) for process in processes] == [0, 0]
    weights = [_digest(tmp_path / seed / "checkpoints/last/pretrained_model") for seed in ("1", "2")]
    assert weights[0] == weights[1]


def _digest(folder: Path) -> str:
    return hashlib.sha256((folder / "model.safetensors").read_bytes()).hexdigest()

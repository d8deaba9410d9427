"""One policy on two GPUs: ``accelerate launch``, with the loss recorded on each."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch

import roboverse_learn
from roboverse_learn.training.metrics import read_metrics
from tests.gpu.test_commands import SMALL

STEPS = 12


@pytest.mark.skipif(torch.cuda.device_count() < 2, reason="needs two GPUs")
def test_two_gpus_with_recorded_losses_take_the_steps_of_one(tmp_path):
    words = [*SMALL, "policy.use_vae=false", "policy.dropout=0", "policy.chunk_size=1"]
    words += ["policy.n_action_steps=1", "precision=fp32", "policy.backbone_norm=frozen"]
    losses = []
    for count in (1, 2):
        run = tmp_path / f"on{count}"
        launched = subprocess.run(
            [sys.executable, "-m", "accelerate.commands.launch", f"--num_processes={count}",
             str(Path(roboverse_learn.__file__).parent / "train.py"), *words, f"run={run}"],
            cwd=tmp_path, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert launched.returncode == 0, launched.stderr[-3000:]
        assert "goes on without" not in launched.stdout + launched.stderr
        losses.append([row["loss"] for row in read_metrics(run)])
    assert len(losses[0]) == STEPS
    assert losses[1] == pytest.approx(losses[0], rel=1e-2)

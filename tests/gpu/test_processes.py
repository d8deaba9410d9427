"""One policy on two GPUs: ``accelerate launch``, with the loss recorded on each."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

import roboverse_learn
from roboverse_learn.collect import collect_dataset
from roboverse_learn.config.compose import compose
from roboverse_learn.training.checkpoint import last_checkpoint
from roboverse_learn.training.metrics import read_metrics
from tests.gpu.marks import COMPILES
from tests.gpu.test_commands import SMALL
from tests.roboverse_learn.training.test_distributed import worker

pytestmark = [*COMPILES, pytest.mark.skipif(torch.cuda.device_count() < 2, reason="needs two GPUs")]

STEPS, SAVE_EVERY, LONG = 12, 50, 400
NARROW = {
    "act": ("dim_model=64", "dim_feedforward=64", "n_encoder_layers=1"),
    "diffusion": ("down_dims=[32,64]", "num_inference_steps=4"),
}


def start(folder: Path, words, run: str, count: int = 2) -> subprocess.Popen:
    """Trains in ``count`` processes, a GPU each."""
    script = Path(roboverse_learn.__file__).parent / "train.py"
    launch = ["torch.distributed.run", "--standalone", f"--nproc_per_node={count}"]
    with (folder / f"{run}.log").open("a") as log:
        return subprocess.Popen(
            [sys.executable, "-m", *launch, str(script), *words, f"run={folder / run}"],
            cwd=folder, env=os.environ | {"PYTHONFAULTHANDLER": "1"}, stdout=log, stderr=log,
        )  # fmt: skip


def finish(folder: Path, **started: subprocess.Popen) -> None:
    for run, process in started.items():
        # Long enough for the stacks of a process that a signal ended, above the launcher's own words.
        assert process.wait() == 0, (folder / f"{run}.log").read_text()[-12000:]
        assert "continues without" not in (folder / f"{run}.log").read_text()


def losses(run: Path) -> dict[int, float]:
    return {int(row["step"]): row["loss"] for row in read_metrics(run)}


def test_two_gpus_with_recorded_losses_take_the_steps_of_one(tmp_path):
    words = [*SMALL, "policy.use_vae=false", "policy.dropout=0", "policy.chunk_size=1"]
    words += ["policy.n_action_steps=1", "precision=fp32", "policy.backbone_norm=frozen"]
    finish(tmp_path, on1=start(tmp_path, words, "on1", 1))
    finish(tmp_path, on2=start(tmp_path, words, "on2", 2))
    one, two = (list(losses(tmp_path / run).values()) for run in ("on1", "on2"))
    assert len(one) == STEPS
    assert two == pytest.approx(one, rel=1e-2)


@pytest.mark.parametrize("policy", ["act", "diffusion"])
def test_two_gpus_learn_as_one_and_a_killed_process_changes_nothing(tmp_path, policy):
    """The losses of one batch of both GPUs are those of one within noise, also after a kill of either."""
    words = [f"policy={policy}", "task=PickCube", "preset=gpu", "image_size=64", "num_demos=8"]
    words += [*NARROW[policy], "train.compile=false", "batch_size=32", "warmup_steps=2", "log_every=10"]
    words += ["time_limit_s=null", f"save_every={SAVE_EVERY}", f"steps={LONG}", "evaluate.videos=0"]
    words += ["levels=[0]", "splits=[test]", "episodes=1", "evaluate.num_envs=1"]
    collection = ["task=PickCube", "simulator=mujoco_warp", "cameras=[front,wrist]", "image_size=64"]
    summary = collect_dataset(
        compose("collect", [*collection, "num_demos=8", "num_envs=8", f"datasets_dir={tmp_path}"])
    )
    words.append(f"dataset={summary.root}")
    started = {
        "on1": start(tmp_path, words, "on1", 1),
        "on2": start(tmp_path, words, "on2"),
        "lost0": start(tmp_path, words, "lost0"),
        "lost1": start(tmp_path, words, "lost1"),
    }
    waiting = {0, 1}
    while waiting:
        for rank in sorted(waiting):
            broken, run = started[f"lost{rank}"], tmp_path / f"lost{rank}"
            assert broken.poll() is None, (tmp_path / f"lost{rank}.log").read_text()[-3000:]
            if max(losses(run), default=0) > SAVE_EVERY:
                os.kill(worker(broken.pid, rank), signal.SIGKILL)
                waiting.discard(rank)
        time.sleep(0.01)
    for rank in (0, 1):
        assert started.pop(f"lost{rank}").wait() != 0
        last = last_checkpoint(tmp_path / f"lost{rank}")
        assert last is not None and SAVE_EVERY <= int(last.name) < LONG
    finish(tmp_path, **{f"lost{rank}": start(tmp_path, words, f"lost{rank}") for rank in (0, 1)}, **started)

    one, two = (losses(tmp_path / run) for run in ("on1", "on2"))
    assert list(two) == list(one) == list(range(10, LONG + 1, 10))
    windows = [np.reshape(list(found.values()), (-1, 10)).mean(1) for found in (one, two)]  # of 100 steps
    np.testing.assert_allclose(windows[1], windows[0], rtol=0.15)
    assert windows[1][-1] < 0.5 * two[10]
    for rank in (0, 1):
        resumed = losses(tmp_path / f"lost{rank}")
        assert list(resumed) == list(two)
        np.testing.assert_allclose(list(resumed.values()), list(two.values()), rtol=0.05)

"""A process of a sweep ends with the sweep."""

import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

CHILD = """
import os, sys, time
from roboverse_learn.commands.child_process import end_with_parent
end_with_parent()
print(os.getpid(), "ROBOVERSE_ENDS_WITH_PARENT" in os.environ, flush=True)
time.sleep({seconds})
sys.exit(3)
"""
PARENT = """
import os, sys
from roboverse_learn.commands.child_process import Children
with open(sys.argv[1], "wb") as output:
    sys.exit(Children().run([sys.executable, "-c", sys.argv[2]], output, dict(os.environ)))
"""


def start(log: Path, seconds: float) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-c", PARENT, str(log), CHILD.format(seconds=seconds)])


def test_the_exit_code_is_that_of_the_process(tmp_path):
    assert start(tmp_path / "log", 0).wait(60) == 3
    assert (tmp_path / "log").read_text().split()[1] == "False", "what it starts has another parent"


@pytest.mark.slow
def test_a_process_ends_when_its_parent_is_killed(tmp_path):
    log = tmp_path / "log"
    parent = start(log, 600)
    while not (log.exists() and log.read_text().endswith("\n")):
        assert parent.poll() is None
        time.sleep(0.05)
    child = psutil.Process(int(log.read_text().split()[0]))
    parent.kill()
    parent.wait()
    child.wait(30)
    assert not psutil.pid_exists(child.pid) or os.name == "nt"


RECIPE = """
policy_name: act
image_size: 32
collect: {num_demos: 2, num_workers: 1}
policy: {chunk_size: 8, n_action_steps: 4, dim_model: 32, n_heads: 2, dim_feedforward: 32,
  n_encoder_layers: 1, use_vae: false, vision_backbone: keypoints}
train: {steps: 400, batch_size: 4, save_every: 50, warmup_steps: 1}
evaluate: {levels: [0], splits: [test], episodes: 2, videos: 0}
"""


@pytest.mark.long
def test_a_killed_sweep_of_a_recipe_leaves_no_process_and_is_finished_by_the_same_command(tmp_path):
    (tmp_path / "tiny_v0.yaml").write_text(RECIPE)
    words = ["recipe=tiny_v0.yaml", "tasks=[PickCube]", "levels=[0]", "seeds=[0]"]
    command = [sys.executable, "-m", "roboverse_learn.cli", "sweep", *words]
    sweep = subprocess.Popen(command, cwd=tmp_path)
    while not list(tmp_path.glob("runs/*/*/*/checkpoints/*")):
        assert sweep.poll() is None, "it ended before it was killed"
        time.sleep(0.1)
    processes = psutil.Process(sweep.pid).children(recursive=True)
    sweep.kill()
    sweep.wait()
    assert processes and not psutil.wait_procs(processes, 60)[1]
    assert not list(tmp_path.glob("results/*/*/*/*.json"))

    assert subprocess.run([*command, "dry_run=true"], cwd=tmp_path, check=False).returncode == 0
    assert subprocess.run(command, cwd=tmp_path, check=False).returncode == 0
    assert len(list(tmp_path.glob("results/*/*/*/*.json"))) == 1
    (log,) = tmp_path.glob("runs/sweep-logs/train-*.log")
    assert "resum" in log.read_text().lower()

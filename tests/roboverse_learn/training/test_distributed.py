"""Two processes of ``accelerate launch`` compute what one computes."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import psutil
import pytest
import torch
from safetensors.torch import load_file
from torch import nn

import policies
import roboverse_learn
from envs.core.errors import ConfigError
from roboverse_learn.training.checkpoint import last_checkpoint
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.imitation.gradient_mean import average_gradients
from roboverse_learn.training.imitation.train import train
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.reporter import Reporter
from tests import imported_process
from tests.policies.examples import NARROW_CONFIGS
from tests.roboverse_learn.training.frames import SquareFrames

# Nothing that depends on which process a sample is in: no dropout, no batch statistics, no padding.
POLICY = replace(NARROW_CONFIGS["act"], chunk_size=1, n_action_steps=1, use_vae=False, backbone_norm="frozen")
CONFIG = TrainConfig(
    steps=4, batch_size=8, warmup_steps=0, precision="fp32", num_threads=1, save_every=4, log_every=1
)


def run(folder: Path, reporter: Reporter | None = None, config: TrainConfig = CONFIG) -> Any:
    data = SquareFrames()
    policy = policies.create("act", data.features, data.stats, POLICY)
    train(policy, data, config, folder, reporter=reporter)
    return policy


RANK = """
from pathlib import Path
from tests.roboverse_learn.training.signals import SignalAt
from tests.roboverse_learn.training.test_distributed import run
run(Path(sys.argv[1]), SignalAt(int(sys.argv[2])) if len(sys.argv) > 2 else None)
"""
TIMED_RANK = """
import itertools
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from safetensors.torch import save_file
import roboverse_learn.training.imitation.train
from tests.roboverse_learn.training.test_distributed import CONFIG, run
# Each look at a clock takes 8 ms of it in the first process, 12 ms in the second, also on a busy machine.
looks, look_s = itertools.count(), 0.008 + 0.004 * int(os.environ["RANK"])
clock = SimpleNamespace(perf_counter=lambda: next(looks) * look_s)
roboverse_learn.training.imitation.train.time = clock
timed = replace(CONFIG, steps=100_000, time_limit_s=1.5, save_every=100_000)
policy = run(Path(sys.argv[1]), config=timed)
save_file(policy.model.state_dict(), Path(sys.argv[1], f"weights_{os.environ['RANK']}.safetensors"))
"""
REPAIRING_RANK = """
import time
from pathlib import Path
from roboverse_learn.training import checkpoint
from tests.roboverse_learn.training.test_distributed import run
repair, look = checkpoint.remove_leftovers, checkpoint.last_checkpoint
def repair_late(folder):
    time.sleep(1.0)
    repair(folder)
def look_and_tell(folder):
    found = look(folder)
    print("found", found.name, flush=True)
    return found
checkpoint.remove_leftovers, checkpoint.last_checkpoint = repair_late, look_and_tell
run(Path(sys.argv[1]))
"""


def ranks(folder: Path, signal_at: int | None = None, program: str = RANK) -> list[BaseProcess]:
    """Runs a program in two processes with the environment that ``accelerate launch`` gives.

    At the step ``signal_at`` only the first of them gets the signal.
    """
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    shared = os.environ | {
        "WORLD_SIZE": "2",
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": port,
        "ACCELERATE_USE_CPU": "true",
    }
    words = [str(folder)] if signal_at is None else [str(folder), str(signal_at)]
    program = imported_process.FIND_TESTS + program
    return [
        imported_process.start(
            program, *words, folder=folder.parent, out=folder.parent / f"rank_{rank}.log",
            env=shared | {"RANK": rank, "LOCAL_RANK": rank},
        )
        for rank in ("0", "1")
    ]  # fmt: skip


def said_by_ranks(folder: Path) -> str:
    return "".join(log.read_text() for log in sorted(folder.glob("rank_*.log")))


@pytest.mark.slow
def test_two_processes_follow_one_clock(tmp_path):
    both = ranks(tmp_path / "limited", program=TIMED_RANK)
    assert imported_process.wait_for_all(both, 120) == [0, 0], said_by_ranks(tmp_path)
    first, second = (load_file(tmp_path / f"limited/weights_{rank}.safetensors") for rank in "01")
    assert all(first[key].equal(second[key]) for key in first), "one learning rate for both"
    assert 4 < read_metrics(tmp_path / "limited")[-1]["step"] < 100_000


@pytest.mark.slow
def test_two_processes_take_the_steps_of_one(tmp_path):
    two = ranks(tmp_path / "two")
    run(tmp_path / "one")
    assert imported_process.wait_for_all(two, 120) == [0, 0], said_by_ranks(tmp_path)
    one, two = (read_metrics(tmp_path / name) for name in ("one", "two"))
    assert [row["step"] for row in two] == [1, 2, 3, 4]
    assert [row["loss"] for row in two] == pytest.approx([row["loss"] for row in one], rel=1e-3)
    assert policies.load(tmp_path / "two").name == "act"


def test_the_mean_gradient_is_that_of_all_processes(monkeypatch):
    first, second = nn.Parameter(torch.zeros(2, 2)), nn.Parameter(torch.zeros(3))
    first.grad, second.grad = torch.full((2, 2), 1.0), torch.tensor([1.0, 2.0, 3.0])
    others = torch.tensor([3.0, 3.0, 3.0, 3.0, 5.0, 0.0, -3.0])
    monkeypatch.setattr(torch.distributed, "all_reduce", lambda flat: flat.add_(others))
    average_gradients([first, nn.Parameter(torch.zeros(4)), second], 2)
    assert first.grad.tolist() == [[2.0, 2.0], [2.0, 2.0]] and second.grad.tolist() == [3.0, 1.0, 0.0]


@pytest.mark.parametrize("order", [torch.contiguous_format, torch.channels_last], ids=str)
def test_the_mean_gradient_is_in_the_order_of_the_parameters_memory(monkeypatch, order):
    weight = nn.Parameter(torch.zeros(2, 2, 1, 2).to(memory_format=torch.channels_last))
    mine = torch.arange(8.0).reshape(2, 2, 1, 2)
    weight.grad = mine.contiguous(memory_format=order)
    # Another process's gradient of 1 at [0, 1, 0, 0] alone, which is second in memory.
    others = torch.tensor([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    monkeypatch.setattr(torch.distributed, "all_reduce", lambda flat: flat.add_(others))
    average_gradients([weight], 2)
    expected = mine / 2
    expected[0, 1, 0, 0] += 0.5
    assert torch.equal(weight.grad, expected)


@pytest.mark.slow
def test_a_signal_to_one_process_ends_both_with_a_checkpoint(tmp_path):
    both = ranks(tmp_path / "run", signal_at=3)
    codes, said = imported_process.wait_for_all(both, 120), said_by_ranks(tmp_path)
    assert codes == [1, 1], said
    assert last_checkpoint(tmp_path / "run").name == "000003"
    assert said.count("Interrupted: SIGTERM") == 2, said


@pytest.mark.slow
def test_both_processes_look_for_the_checkpoint_after_the_first_has_put_it_right(tmp_path):
    run(tmp_path / "run")
    checkpoints = tmp_path / "run" / "checkpoints"
    (checkpoints / "last").unlink()
    (checkpoints / "000004").rename(checkpoints / "last")  # as in a copy that has it alone
    both = ranks(tmp_path / "run", program=REPAIRING_RANK)
    assert imported_process.wait_for_all(both, 120) == [0, 0], said_by_ranks(tmp_path)
    assert said_by_ranks(tmp_path).count("found 000004") == 2, said_by_ranks(tmp_path)


def test_a_batch_that_cannot_be_divided_is_an_error(monkeypatch, tmp_path):
    import accelerate

    monkeypatch.setattr(accelerate.Accelerator, "num_processes", 3)
    with pytest.raises(ConfigError, match="batch_size 8 must be a positive multiple of 3 processes"):
        run(tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("killed", [0, 1])
def test_a_run_whose_process_is_killed_goes_on_to_the_same_weights(tmp_path, killed):
    words = ["policy=act", "task=PickCube", "preset=quick", "num_demos=2", "image_size=32", "dim_model=32"]
    words += ["device=cpu", "n_heads=2", "steps=200", "batch_size=4", "save_every=20", "log_every=1"]
    words += ["levels=[0]", "splits=[test]", "episodes=1", "evaluate.videos=0"]
    with launched(tmp_path, words, "whole") as whole:
        assert whole.wait() == 0, log_of(tmp_path, "whole")
    with launched(tmp_path, words, "broken") as broken:
        while max((row["step"] for row in read_metrics(tmp_path / "broken")), default=0) < 25:
            assert broken.poll() is None, log_of(tmp_path, "broken")
            time.sleep(0.02)
        os.kill(worker(broken.pid, killed), signal.SIGKILL)
        assert broken.wait() != 0
    assert 20 <= int(last_checkpoint(tmp_path / "broken").name) < 200
    with launched(tmp_path, words, "broken") as resumed:
        assert resumed.wait() == 0, log_of(tmp_path, "broken")
    ends = [tmp_path / run / "checkpoints" / "last" / "pretrained_model" for run in ("whole", "broken")]
    one, two = (load_file(end / "model.safetensors") for end in ends)
    assert one.keys() == two.keys()
    assert [name for name, value in one.items() if not torch.equal(value, two[name])] == []


@contextmanager
def launched(folder: Path, words: list[str], run: str) -> Iterator[subprocess.Popen]:
    """Trains in two processes on the CPU as ``accelerate launch`` does on GPUs; they end with the block."""
    script = Path(roboverse_learn.__file__).parent / "train.py"
    launch = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc_per_node=2"]
    command = [*launch, str(script), *words, f"run={folder / run}"]
    env = os.environ | {"ACCELERATE_USE_CPU": "true", "OMP_NUM_THREADS": "1"}
    with (folder / f"{run}.log").open("a") as log:
        process = subprocess.Popen(command, cwd=folder, env=env, stdout=log, stderr=log)
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def log_of(folder: Path, run: str) -> str:
    return (folder / f"{run}.log").read_text()[-3000:]


def worker(launcher: int, rank: int) -> int:
    """Returns the process that trains as a rank."""
    children = psutil.Process(launcher).children(recursive=True)
    return next(child.pid for child in children if child.environ().get("RANK") == str(rank))

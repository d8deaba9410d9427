"""A training process that is really killed, and how it resumes."""

import random
import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest

import policies
from roboverse_learn.training.checkpoint import last_checkpoint
from roboverse_learn.training.config import AugmentConfig, TrainConfig
from roboverse_learn.training.imitation.train import train
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.reporter import Reporter
from tests import imported_process
from tests.policies.examples import NARROW_CONFIGS
from tests.roboverse_learn.training.frames import SquareFrames

STEPS = 18
# Dropout, augmentation and the VAE all draw from the global generator.
POLICY = replace(NARROW_CONFIGS["act"], dropout=0.1)
CONFIG = TrainConfig(
    steps=STEPS, batch_size=4, lr=1e-3, warmup_steps=2, precision="fp32", num_threads=1, save_every=6,
    log_every=1, ema=True, augment=AugmentConfig(shift_px=2, brightness=0.2),
)  # fmt: skip


class Waits(Reporter):
    """Waits at a step for the kill, should it be late."""

    def __init__(self, step: int) -> None:
        self.step = step

    def on_step(self, progress):
        if progress.step == self.step:
            time.sleep(60)


def run(folder: Path, reporter: Reporter | None = None) -> None:
    data = SquareFrames()
    policy = policies.create("act", data.features, data.stats, POLICY)
    train(policy, data, CONFIG, folder, reporter=reporter)


def losses(folder):
    return [(row["step"], row["loss"]) for row in read_metrics(folder)]


WAITING = """
from pathlib import Path
from tests.roboverse_learn.training.imitation.test_killed import Waits, run
run(Path(sys.argv[1]), Waits(int(sys.argv[2])))
"""


def kill(folder: Path, kills: int, seed: int) -> list[int]:
    """Kills runs that resume from each other with SIGKILL; returns the step that each had logged."""
    rng, reached, seen = random.Random(seed), [], 0
    for number in range(kills):
        wanted, log = STEPS * (number + 1) // (kills + 1), folder.with_suffix(".log")
        program = imported_process.FIND_TESTS + WAITING
        process = imported_process.start(program, str(folder), str(wanted + 4), folder=folder.parent, out=log)
        deadline = time.monotonic() + 60
        while seen < wanted and time.monotonic() < deadline:
            time.sleep(0.01)
            seen = max((row["step"] for row in read_metrics(folder)), default=0)
        time.sleep(rng.uniform(0.0, 0.15))
        process.kill()
        process.join()
        assert process.exitcode == -signal.SIGKILL, log.read_text()
        reached.append(max(row["step"] for row in read_metrics(folder)))
    return reached


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was left alone."""
    folder = tmp_path_factory.mktemp("straight")
    run(folder)
    return folder


@pytest.mark.long
@pytest.mark.parametrize("seed", range(25))
def test_a_run_killed_twice_ends_as_one_that_was_left_alone(tmp_path, straight, seed):
    """Of all seeds, 50 kills."""
    reached = kill(tmp_path / "killed", kills=2, seed=seed)
    assert reached == sorted(reached) and reached[-1] < STEPS
    newest = last_checkpoint(tmp_path / "killed")
    assert newest is not None and int(newest.name) % 6 == 0

    run(tmp_path / "killed")
    assert losses(tmp_path / "killed") == losses(straight)
    whole, resumed = (
        folder / "checkpoints/last/pretrained_model" for folder in (straight, tmp_path / "killed")
    )
    for name in ("model.safetensors", "config.json"):
        assert (resumed / name).read_bytes() == (whole / name).read_bytes()
    # A killed save may leave a hidden folder; a listed checkpoint is whole.
    for folder in (tmp_path / "killed" / "checkpoints").glob("[0-9]*"):
        assert policies.load(folder).name == "act"

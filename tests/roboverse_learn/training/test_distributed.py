"""Two processes of ``accelerate launch`` compute what one computes."""

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest

import policies
from envs.core.errors import ConfigError
from roboverse_learn.training.checkpoint import last_checkpoint
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.imitation.train import train
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.reporter import Reporter
from tests.policies.examples import NARROW_CONFIGS
from tests.roboverse_learn.training.frames import SquareFrames

# Nothing that depends on which process a sample is in: no dropout, no batch statistics, no padding.
POLICY = replace(NARROW_CONFIGS["act"], chunk_size=1, n_action_steps=1, use_vae=False, backbone_norm="frozen")
CONFIG = TrainConfig(
    steps=4, batch_size=8, warmup_steps=0, precision="fp32", num_threads=1, save_every=4, log_every=1
)


def run(folder: Path, reporter: Reporter | None = None, config: TrainConfig = CONFIG) -> None:
    data = SquareFrames()
    policy = policies.create("act", data.features, data.stats, POLICY)
    train(policy, data, config, folder, reporter=reporter)


@pytest.mark.slow
def test_two_processes_take_the_steps_of_one(tmp_path, processes):
    processes.ask("launch", folder=str(tmp_path / "two"))
    run(tmp_path / "one")
    assert processes.answer() == [0, 0], processes.errors()
    one, two = (read_metrics(tmp_path / name) for name in ("one", "two"))
    assert [row["step"] for row in two] == [1, 2, 3, 4]
    assert [row["loss"] for row in two] == pytest.approx([row["loss"] for row in one], rel=1e-3)
    assert policies.load(tmp_path / "two").name == "act"


@pytest.mark.slow
def test_a_signal_to_one_process_ends_both_with_a_checkpoint(tmp_path, processes):
    processes.ask("launch", folder=str(tmp_path), signal_at=3)
    assert processes.answer() == [1, 1], processes.errors()
    assert last_checkpoint(tmp_path).name == "000003"
    said = processes.errors()
    assert said.count("Interrupted: SIGTERM") == 2, said


def test_a_batch_that_cannot_be_divided_is_an_error(monkeypatch, tmp_path):
    import accelerate

    monkeypatch.setattr(accelerate.Accelerator, "num_processes", 3)
    with pytest.raises(ConfigError, match="batch_size 8 must be a positive multiple of 3 processes"):
        run(tmp_path)


def test_graphs_are_played_back_by_one_process_only(monkeypatch, tmp_path, caplog):
    import accelerate

    monkeypatch.setattr(accelerate.Accelerator, "num_processes", 2)
    monkeypatch.setattr(accelerate.Accelerator, "prepare", Mock(side_effect=InterruptedError))
    with pytest.raises(InterruptedError):
        run(tmp_path, config=replace(CONFIG, cuda_graphs=True))
    assert "cuda_graphs is for one process, and these are 2: they train without." in caplog.text

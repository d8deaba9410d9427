"""The commands on a GPU: collection, training that is stopped and resumed, evaluation."""

import logging
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.results import read_result
from roboverse_learn import cli
from roboverse_learn.collect import collect_dataset
from roboverse_learn.commands.run_folder import read_facts
from roboverse_learn.config.compose import compose
from roboverse_learn.data import DatasetInfo
from roboverse_learn.data.dataset.reader import ResidentDataset
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.reporter import ProgressReporter
from tests.gpu.marks import COMPILES

pytestmark = COMPILES

SMALL = (
    *("policy=act", "task=PickCube", "preset=gpu", "image_size=64", "num_demos=4", "collect.num_envs=4"),
    *("steps=12", "time_limit_s=null", "batch_size=8", "warmup_steps=2", "save_every=4", "log_every=1"),
    *("train.compile=false", "dim_model=64", "dim_feedforward=64", "n_encoder_layers=1"),
    *("levels=[0,3]", "splits=[test]", "episodes=2", "evaluate.num_envs=2"),
)
BY_REWARD = (
    *("policy=ppo", "task=control/cartpole", "simulator=mujoco_warp", "policy.num_envs=32"),
    *("policy.num_steps=8", "policy.num_minibatches=4", "hidden_dims=[32]", "steps=1024"),
    *("save_every=256", "log_every=256", "levels=[0]", "splits=[test]", "episodes=2", "evaluate.num_envs=2"),
)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("level", [0, 3])
def test_demonstrations_are_collected_on_the_gpu(level):
    words = ["task=PickCube", "simulator=mujoco_warp", f"level={level}", "cameras=[front,wrist]"]
    words += ["image_size=48", "num_demos=3", "num_envs=3"]
    summary = collect_dataset(compose("collect", words))
    assert summary.num_episodes == 3 and summary.num_attempts <= 9
    dataset = ResidentDataset(summary.root, device="cuda")
    assert dataset.info.num_episodes == 3 and len(dataset) == summary.num_frames > 60
    for camera in ("front", "wrist"):
        images = dataset.frames[f"observation.images.{camera}"]
        assert images.is_cuda and images.dtype == torch.uint8 and images.shape[1:] == (3, 48, 48)
        assert images.float().std() > 5
    state, action = dataset.frames["observation.state"], dataset.frames["action"]
    assert state.isfinite().all() and action.isfinite().all()
    assert (state[1:] - state[:-1]).abs().max() > 0.005


def test_another_arm_follows_demonstrations_on_the_gpu(folder):
    """All paths are followed in one batch of inverse kinematics."""
    made = ["task=PickCube", "cameras=[front]", "image_size=16", "num_demos=3"]
    recorded = collect_dataset(compose("collect", [*made, "simulator=mujoco", "dataset=recorded"]))
    words = [*made, "source=retarget", f"from={recorded.root}", "robot=ur5e", "simulator=mujoco_warp"]
    summary = collect_dataset(compose("collect", [*words, "num_envs=3"]))
    assert summary.outcome == "3 of 3 retargeted demonstrations were kept (100.0 %)"
    info = DatasetInfo.open(summary.root)
    assert info.robot_type == "ur5e"
    assert all(facts["max_error_m"] < 1e-3 for facts in info.episode_metadata)


def stopped_and_resumed(words, stop_at, monkeypatch, caplog):
    """Runs a training, stops it once it is beyond a step, and runs the same command to the end.

    Returns:
        The run's folder and its result.
    """

    def stop(self, progress):
        if progress.step >= stop_at:
            raise KeyboardInterrupt

    caplog.set_level(logging.INFO)
    with monkeypatch.context() as patch:
        patch.setattr(ProgressReporter, "on_step", stop)
        assert cli.main(["train", *words]) == 130
    caplog.clear()
    assert cli.main(["train", *words]) == 0
    assert "from step" in caplog.text
    assert "changes the gradient" not in caplog.text
    (config,) = Path("runs").glob("*/**/config.yaml")
    (path,) = Path("results").glob("v*/**/*.json")
    return config.parent, read_result(path)


def test_imitation_is_stopped_resumed_and_evaluated_on_the_gpu(folder, monkeypatch, caplog):
    run, result = stopped_and_resumed(SMALL, 6, monkeypatch, caplog)
    rows = read_metrics(run)
    assert [row["step"] for row in rows] == list(range(1, 13))
    assert np.isfinite([row["loss"] for row in rows]).all()
    assert read_facts(run, "collect")["num_episodes"] == 4
    assert (result.env.simulator, result.checkpoint.step, len(result.records)) == ("mujoco_warp", 12, 4)
    assert [str(cell.cell) for cell in result.cells()] == ["level 0, test split", "level 3, test split"]
    assert len(list(folder.glob("results/v*/**/*.mp4"))) == 2
    words = ["levels=[1]", "splits=[test]", "episodes=2", "evaluate.num_envs=2", "videos=0"]
    assert cli.main(["evaluate", f"checkpoint={run}", *words]) == 0


def test_learning_by_reward_is_stopped_resumed_and_evaluated_on_the_gpu(folder, monkeypatch, caplog):
    run, result = stopped_and_resumed(BY_REWARD, 600, monkeypatch, caplog)
    assert [row["step"] for row in read_metrics(run)] == [256, 512, 768, 1024]
    assert (result.env.simulator, result.sees_images, len(result.records)) == ("mujoco_warp", False, 2)
    assert all(np.isfinite(record.episode_return) for record in result.records)

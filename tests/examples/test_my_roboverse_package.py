"""The example package, installed as a user installs it: every command accepts what it registers."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from pyarrow import parquet

from tests import imported_process

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "my_roboverse_package"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Returns the environment variables of processes that have the package."""
    pytest.importorskip("setuptools", minversion="77", reason="builds the example without a package index")
    target = tmp_path_factory.mktemp("site")
    copy = tmp_path_factory.mktemp("source") / EXAMPLE.name
    subprocess.run(["cp", "-r", str(EXAMPLE), str(copy)], check=True)
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "--target", str(target), str(copy)], check=True)
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(target), str(ROOT)])}


def run(installed, *words):
    return imported_process.run(imported_process.COMMAND, *words, env=installed)


def test_task_of_an_installed_package_is_listed(installed):
    done = run(installed, "list", "tasks")
    assert done.returncode == 0, done.stderr
    assert "PushCubeOverLine" in done.stdout and "from my-roboverse-package" in done.stdout


def test_channel_and_level_of_an_installed_package_are_listed(installed):
    done = run(installed, "list", "channels", "levels")
    assert done.returncode == 0, done.stderr
    assert "tint " in done.stdout and "only=tinted" in done.stdout
    assert "3" in done.stdout and "task + environment + camera + lighting" in done.stdout


def test_level_of_an_installed_package_is_collected_with_its_channel(installed, tmp_path):
    words = ("task=PushCubeOverLine", "only=tinted", "collect.num_demos=2", "collect.num_workers=2")
    done = run(installed, "collect", *words, "image_size=32", f"dataset={tmp_path / 'd'}")
    assert done.returncode == 0, done.stderr
    (episodes,) = (tmp_path / "d" / "meta" / "episodes").rglob("*.parquet")
    facts = [json.loads(text) for text in parquet.read_table(episodes)["roboverse/metadata"].to_pylist()]
    assert all(fact["channels"] == ["task", "environment", "camera", "tint"] for fact in facts)


def test_unknown_channel_in_a_level_is_an_error(installed, tmp_path):
    done = run(installed, "collect", "task=PushCubeOverLine", "only=tnted", f"dataset={tmp_path / 'd'}")
    assert done.returncode == 2
    assert "Unknown channel 'tnted'. Did you mean 'tinted'?" in done.stderr


def test_task_of_an_installed_package_is_collected_with_its_robot(installed, tmp_path):
    words = (
        "task=PushCubeOverLine",
        "task_kwargs.line_x_m=0.1",
        "collect.num_demos=2",
        "collect.num_workers=1",
    )
    done = run(installed, "collect", *words, "image_size=32", f"dataset={tmp_path / 'd'}")
    assert done.returncode == 0, done.stderr
    info = json.loads((tmp_path / "d" / "meta" / "info.json").read_text(encoding="utf-8"))
    assert info["total_episodes"] == 2 and info["robot_type"] == "franka_on_block"


def test_policy_of_an_installed_package_trains_resumes_evaluates_and_is_on_the_board(installed, tmp_path):
    words = (
        "train", "policy=chunk_cnn", "task=PushCubeOverLine", "collect.num_demos=2", "collect.num_workers=1",
        "image_size=32", "policy.hidden_dim=16", "policy.chunk_size=8", "train.batch_size=4",
        "train.save_every=2", "train.log_every=1", "train.schedule=constant",
        "train.num_threads=1", "evaluate.episodes=1", "levels=[0,1]", "alone=[tint,tinted]", "videos=0",
        "device=cpu",
        f"datasets_dir={tmp_path / 'd'}", f"results_dir={tmp_path / 'results'}",
    )  # fmt: skip
    halves = [run(installed, *words, f"run={tmp_path / 'halves'}", f"train.steps={n}") for n in (2, 4)]
    whole = run(installed, *words, f"run={tmp_path / 'whole'}", "train.steps=4")
    for done in (*halves, whole):
        assert done.returncode == 0, done.stderr
    losses = [_losses(tmp_path / name) for name in ("halves", "whole")]
    assert losses[0] == losses[1] and len(losses[0]) == 4
    board = json.loads((tmp_path / "results" / "leaderboard.json").read_text(encoding="utf-8"))
    assert "chunk_cnn" in json.dumps(board)
    files = (tmp_path / "results").rglob("*.json")
    assert any('"only": "tinted"' in path.read_text(encoding="utf-8") for path in files)
    out = ("task=PushCubeOverLine", "levels=[3]", "evaluate.episodes=1", "videos=0", "device=cpu")
    done = run(
        installed, "evaluate", f"checkpoint={tmp_path / 'whole'}", *out, f"results_dir={tmp_path / 'r'}"
    )
    assert done.returncode == 0, done.stderr


def test_an_option_out_of_range_is_refused_by_the_task(installed, tmp_path):
    done = run(
        installed, "collect", "task=PushCubeOverLine", "task_kwargs.line_x_m=3", f"dataset={tmp_path / 'd'}"
    )
    assert done.returncode == 2
    assert "task_kwargs.line_x_m must be 0.07 to 0.2, given 3" in done.stderr
    assert not (tmp_path / "d").exists()


def _losses(run_dir):
    lines = (run_dir / "metrics.jsonl").read_text(encoding="utf-8").splitlines()
    return [json.loads(line)["loss"] for line in lines]

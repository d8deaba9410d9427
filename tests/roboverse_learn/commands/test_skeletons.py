"""What ``roboverse new`` writes works at once: it is checked, trained, and installed, as its README says."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from roboverse_learn.config.other_commands import NewConfig
from roboverse_learn.new import new
from tests import imported_process

ROOT = Path(__file__).resolve().parents[3]


def roboverse(folder: Path, *words: str, path: str = "") -> subprocess.CompletedProcess[str]:
    """Runs a command in a folder, as a newcomer does: nothing of it is on the path."""
    kept = {key: value for key, value in os.environ.items() if key != "ROBOVERSE_PLUGINS"}
    env = kept | {"PYTHONPATH": os.pathsep.join(filter(None, [path, str(ROOT)])), "COLUMNS": "200"}
    return imported_process.run(imported_process.COMMAND, *words, folder=folder, env=env)


def done(folder: Path, *words: str, path: str = "") -> str:
    ended = roboverse(folder, *words, path=path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("newcomer")
    for kind, name in (("task", "LiftBlock"), ("policy", "my_cnn"), ("robot", "my_arm")):
        config = NewConfig(kind=kind, name=name)
        new(replace(config, out=str(folder / config.module)))
    return folder


@pytest.mark.slow
def test_the_task_keeps_every_contract(folder: Path) -> None:
    said = done(folder, "check", "task=LiftBlock", "image_size=32", "plugins=[lift_block]")
    assert "20 of 20 starts" in said and " 0 failed, 0 skipped." in said


@pytest.mark.slow
def test_the_robot_keeps_every_contract(folder: Path) -> None:
    assert " 0 failed, 0 skipped." in done(folder, "check", "robot=my_arm", "plugins=[my_arm]")


@pytest.mark.long
def test_the_task_of_the_robot_keeps_every_contract_in_its_own_folder(folder: Path) -> None:
    words = ("check", "task=MyArmReach", "image_size=32", "episodes=10", "plugins=[my_arm]")
    said = done(folder / "my_arm", *words)
    assert "10 of 10 starts" in said and " 0 failed, 0 skipped." in said


@pytest.mark.long
def test_the_policy_keeps_every_contract(folder: Path) -> None:
    assert " 0 failed, 0 skipped." in done(folder, "check", "policy=my_cnn", "plugins=[my_cnn]")


@pytest.mark.slow
def test_the_policy_trains_on_the_task(folder: Path) -> None:
    words = (
        "train", "policy=my_cnn", "task=LiftBlock", "preset=quick", "num_demos=2", "collect.num_workers=2",
        "image_size=32", "train.steps=4", "train.batch_size=4", "train.num_threads=1", "evaluate.episodes=1",
        "levels=[0]", "videos=0", "device=cpu",
    )  # fmt: skip
    assert "Trained 4 steps" in done(folder, *words, "plugins=[lift_block,my_cnn]")


@pytest.mark.long
def test_the_policy_learns_the_task_by_the_quick_preset(folder: Path) -> None:
    words = ("train", "policy=my_cnn", "task=LiftBlock", "preset=quick", "num_demos=150", "levels=[0]")
    said = done(folder, *words, "train.lr=1e-3", "cameras=[all]", "plugins=[lift_block,my_cnn]")
    row = next(line for line in said.splitlines() if "level 0" in line and "%" in line)
    assert float(row.split("│")[2].split("%")[0]) >= 40.0, row


@pytest.mark.long
def test_an_installed_package_needs_no_plugins_and_takes_them_too(folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("setuptools", minversion="77", reason="builds the package without a package index")
    target = tmp_path / "site"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--target", str(target), str(folder / "my_arm")], check=True)
    words = ("check", "robot=my_arm", "contracts=[scene]")
    assert "2 ok" in done(tmp_path, *words, path=str(target))
    assert "2 ok" in done(tmp_path, *words, "plugins=[my_arm]", path=str(target))
    assert "from my-arm" in done(tmp_path, "list", "tasks", path=str(target))

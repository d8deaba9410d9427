import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark import provenance


@pytest.fixture
def checkout(tmp_path):
    """A checkout with one commit of one file."""

    def git(*arguments):
        identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", *identity, *arguments], cwd=tmp_path, check=True, capture_output=True)

    git("init")
    (tmp_path / "results").mkdir()
    for name in ("a.txt", "results/leaderboard.md"):
        (tmp_path / name).write_text("1")
    git("add", ".")
    git("commit", "-m", "first")
    return tmp_path


def test_git_state_of_a_checkout(checkout):
    clean = provenance.git_state(checkout)
    assert clean is not None
    assert (len(clean.sha), clean.dirty) == (40, False)
    (checkout / "new.txt").write_text("untracked files change nothing")
    assert provenance.git_state(checkout) == clean
    (checkout / "results/leaderboard.md").write_text("a run writes its results")
    assert provenance.git_state(checkout / "results") == clean
    (checkout / "a.txt").write_text("2")
    dirty = provenance.git_state(checkout)
    assert dirty is not None
    assert dirty.dirty


def test_a_checkout_whose_state_is_unknown_counts_as_dirty(checkout):
    clean = provenance.git_state(checkout)
    (checkout / ".git/index").write_text("damaged")
    assert clean is not None
    assert provenance.git_state(checkout) == replace(clean, dirty=True)


def test_no_git_state_outside_a_checkout(tmp_path):
    assert provenance.git_state(tmp_path) is None
    subprocess.run(["git", "init", tmp_path], check=True, capture_output=True)
    assert provenance.git_state(tmp_path) is None, "it has no commit"
    assert provenance.git_state(tmp_path / ".git") is None


def test_commands_name_no_folder_of_the_machine(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    arguments = [f"{tmp_path}/train.py", "policy=act", f"out={tmp_path}/runs/a b", "data=/home/someone/data"]
    assert provenance.command_line(arguments) == "python train.py policy=act 'out=runs/a b' data=.../data"


def test_an_installed_command_is_called_by_its_name():
    assert provenance.command_line(["/opt/env/bin/roboverse", "train"]) == "roboverse train"


def test_configurations_name_no_folder_of_the_machine(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    config = {"out": tmp_path / "runs", "parts": ("/data/x", 3), "lr": 1e-4, "none": None}
    assert provenance.portable(config) == {"out": "runs", "parts": [".../x", 3], "lr": 1e-4, "none": None}


def test_versions_name_python_and_what_decides_an_episode():
    versions = provenance.package_versions()
    assert versions["python"] == ".".join(map(str, sys.version_info[:3]))
    assert {"torch", "mujoco", "numpy"} <= set(versions)


def test_versions_are_read_once_and_belong_to_the_caller(monkeypatch):
    provenance.package_versions()["torch"] = "changed by a caller"
    monkeypatch.setattr(provenance, "version", lambda name: pytest.fail(f"{name} was read again"))
    assert provenance.package_versions()["torch"] != "changed by a caller"


def test_machine_has_no_name():
    machine = provenance.machine("cpu")
    assert machine.device == "cpu"
    assert machine.cpu_count >= 1


@pytest.mark.slow
def test_importing_the_benchmark_is_light():
    """Heavy packages are imported where they are used, so that commands start quickly."""
    modules = (
        "results",
        "provenance",
        "runner",
        "videos",
        "leaderboard.build",
        "leaderboard.plots",
        "leaderboard.html",
    )
    heavy = ("torch", "scipy", "matplotlib", "jinja2", "av", "lerobot", "jsonschema_rs")
    imports = ", ".join(f"benchmark.{name}" for name in modules)
    code = f"import sys, {imports}; print([m for m in {heavy} if m in sys.modules])"
    root = Path(provenance.__file__).parents[1]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert done.stdout.strip() == "[]"

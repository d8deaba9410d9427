"""``.ci/gpu``: it packs what a GPU machine needs, and reports what it ran there."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parents[1]
SCRIPT = ROOT / ".ci/gpu"
PYTHON = """#!/bin/sh
case "$*" in
    *pytest*) echo "$*"; echo "3 passed, 1 skipped in 1.00s"; exit "$CODE" ;;
    *) echo "A GPU, torch 9.9" ;;
esac
"""


def run(*words, cwd=ROOT, **env):
    return subprocess.run(
        [SCRIPT, *words], cwd=cwd, env=os.environ | env, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("code", [0, 1])
def test_a_run_is_reported_with_its_device_commit_and_result(tmp_path, code):
    python = tmp_path / "python"
    python.write_text(PYTHON)
    python.chmod(0o755)
    done = run("report.txt", cwd=tmp_path, PYTHON=str(python), CODE=str(code))
    assert done.returncode == code, done.stderr
    report = (tmp_path / "report.txt").read_text()
    assert "-m pytest -m gpu tests/gpu -n 4" in report
    assert "device:  A GPU, torch 9.9" in report and "tests:   3 passed, 1 skipped in 1.00s" in report
    assert f"result:  {'passed' if code == 0 else 'failed, exit code 1'}" in report
    lines = dict(line.partition(":")[::2] for line in report.splitlines()[:6])
    assert lines["date"].endswith("UTC") and lines["commit"].strip() and int(lines["seconds"]) >= 0


@pytest.mark.slow
@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU here")
def test_without_a_gpu_nothing_runs_and_the_reason_is_printed(tmp_path):
    done = run(str(tmp_path / "report.txt"), PYTHON=sys.executable)
    assert done.returncode == 1 and "sees no GPU here" in done.stderr
    assert not (tmp_path / "report.txt").exists()


@pytest.mark.slow
@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a checkout by git")
def test_a_packed_folder_has_the_tracked_files_and_the_commit(tmp_path):
    folder = tmp_path / "packed"
    assert run("--pack", "packed", cwd=tmp_path).returncode == 0
    for path in ("pyproject.toml", "configs/preset/gpu.yaml", "envs/__init__.py", "tests/conftest.py"):
        assert (folder / path).is_file()
    assert not (folder / "results").exists() and not (folder / "docs").exists()
    assert not any(path.is_symlink() for path in folder.rglob("*"))
    assert len((folder / "COMMIT").read_text().strip()) == 40
    again = run("--pack", str(folder))
    assert again.returncode == 2 and "exists. Name a new folder." in again.stderr


def test_unknown_option_error_lists_valid_ones():
    done = run("--help")
    assert done.returncode == 2 and "Usage: .ci/gpu [REPORT] or .ci/gpu --pack FOLDER" in done.stderr

import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

from envs.core.errors import DatasetError
from roboverse_learn.data.collection.pool import together

ROOT, HERE = Path(__file__).parents[4], Path(__file__).parents[1]
ATTEMPTS = [(index, None) for index in range(3)]


def test_attempts_within_the_time_form_one_group():
    assert list(together(ATTEMPTS, within_s=math.inf)) == [ATTEMPTS]


def test_attempts_further_apart_form_groups_of_their_own():
    assert list(together(ATTEMPTS, within_s=0.0)) == [[attempt] for attempt in ATTEMPTS]


def test_nothing_is_yielded_without_an_attempt():
    assert list(together([])) == []


def test_attempts_before_an_error_are_yielded_first():
    def broken():
        yield from ATTEMPTS
        raise DatasetError("The disk is full.")

    groups = together(broken(), within_s=math.inf)
    assert next(groups) == ATTEMPTS
    with pytest.raises(DatasetError, match="The disk is full"):
        next(groups)


SCRIPT = """
from envs.tasks import TASKS
from roboverse_learn.data import CollectionConfig, collect
from synthetic_episodes import FEATURES, FPS

{before}
print("runs\\n", end="")  # one write, so that no other process writes within the line
if {guard}:
    config = CollectionConfig(
        root="d", num_episodes=4, candidates=range(100, 110), source="synthetic_episodes:SyntheticSource",
        source_kwargs={{}}, fps=FPS, features=FEATURES, num_workers=2,
    )
    print(collect(config).num_episodes, "episodes")
"""
REGISTERS = "TASKS.add('Mine', 'my_module:Mine')"


def run_script(folder, before="", guard="True"):
    """Runs a script in a fresh process, as a user does; returns it ended."""
    (folder / "script.py").write_text(SCRIPT.format(before=before, guard=guard))
    path = os.pathsep.join([str(HERE), str(ROOT)])
    return subprocess.run(
        [sys.executable, "script.py"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
        timeout=240,
    )


@pytest.mark.slow
def test_a_script_without_a_guard_is_run_once(tmp_path):
    done = run_script(tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["runs", "4", "episodes"]


@pytest.mark.slow
def test_a_script_that_registers_and_has_no_guard_ends_with_what_to_do(tmp_path):
    done = run_script(tmp_path, REGISTERS)
    assert done.returncode == 1
    assert "run the script again to know what it registers (Mine)" in done.stderr
    assert 'Put the call below if __name__ == "__main__": or give num_workers=1.' in done.stderr


@pytest.mark.slow
def test_workers_have_what_a_script_with_a_guard_registers(tmp_path):
    done = run_script(tmp_path, REGISTERS, "__name__ == '__main__'")
    assert done.returncode == 0, done.stderr
    assert sorted(done.stdout.split()) == sorted(["4", "episodes", "runs", "runs", "runs"])

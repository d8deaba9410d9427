import subprocess
import sys
from pathlib import Path

import pytest

from benchmark import throughput
from envs.errors import SimulatorError


def test_step_is_compared_on_the_same_physics():
    """No figure is asserted: only that both ran, from the same states to the same states."""
    measured = throughput.measure_step("PickCube", turns=2, num_steps=10)
    assert measured.ours_s > 0
    assert measured.baseline_s > 0
    assert "bare mj_step loop" in str(measured)
    assert "goal ≤ 1.10" in str(measured)


def test_either_goes_first_in_its_turn():
    order = []
    throughput._in_turns(lambda: order.append("ours"), lambda: order.append("baseline"), first=0)
    throughput._in_turns(lambda: order.append("ours"), lambda: order.append("baseline"), first=1)
    assert order == ["ours", "baseline", "baseline", "ours"]


def test_a_picture_is_not_compared_to_another_gl(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    with pytest.raises(SimulatorError, match="MUJOCO_GL is not 'osmesa'"):
        throughput.measure_render("PickCube")


def test_a_missing_library_is_named(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr("ctypes.util.find_library", lambda name: None)
    with pytest.raises(SimulatorError, match=r"libOSMesa is not installed.*apt-get install libosmesa6"):
        throughput.measure_render("PickCube")


def test_an_unknown_task_ends_with_its_message():
    done = subprocess.run(
        [sys.executable, "-m", "benchmark.throughput", "task=PickCub", "turns=1"],
        capture_output=True,
        text=True,
        cwd=Path(throughput.__file__).parents[1],
    )
    assert done.returncode == 1
    assert "not measured. Unknown task 'PickCub'. Did you mean 'PickCube'?" in done.stdout

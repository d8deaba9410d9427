import pytest

from envs.core.errors import SimulatorError
from roboverse_learn.speed import throughput


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


def test_an_unknown_task_ends_with_its_message(monkeypatch, caplog):
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr("os.sched_setaffinity", lambda *_: None)  # the other tests keep their cores
    caplog.set_level("INFO")
    assert throughput.main(["task=PickCub", "turns=1"]) == 1
    assert "not measured. Unknown task 'PickCub'. Did you mean 'PickCube'?" in caplog.text

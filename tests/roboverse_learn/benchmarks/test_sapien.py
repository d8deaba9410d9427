"""The comparison with SAPIEN's own loop: it runs, and compares like with like. Nothing is timed."""

import pytest

pytest.importorskip("sapien", reason="SAPIEN is not installed: pip install 'roboverse-learn[sapien]'")

from envs.errors import SimulatorError
from roboverse_learn.benchmarks import BENCHMARKS, sapien


def test_it_is_registered_and_has_the_goals_that_were_promised():
    assert BENCHMARKS.entry("sapien").target == "roboverse_learn.benchmarks.sapien"
    assert (sapien.OVERHEAD_GOAL, sapien.SPEEDUP_GOAL) == (1.15, 1.7)


def test_the_handler_ends_where_the_loop_ends():
    measurement = sapien.measure_overhead(num_envs=2, turns=1, control_steps=3)
    assert measurement.ours_s > 0 < measurement.baseline_s
    assert str(measurement).startswith(
        "control step of PickCube, 2 environments, one thread: handler / SAPIEN"
    )
    assert "goal ≤ 1.15" in str(measurement)


def test_other_physics_is_not_compared(monkeypatch):
    step = sapien._Loop.run
    monkeypatch.setattr(
        sapien._Loop, "run", lambda self, target, num_steps: step(self, target + 0.1, num_steps)
    )
    with pytest.raises(SimulatorError, match="this is not the same physics"):
        sapien.measure_overhead(turns=1, control_steps=3)


def test_two_processes_are_compared_to_one():
    measurement = sapien.measure_processes(num_envs=2, turns=1, control_steps=2)
    assert measurement.name == "control step of PickCube, 2 environments: speed-up of two processes over one"
    assert measurement.ratio == pytest.approx(measurement.baseline_s / measurement.ours_s)

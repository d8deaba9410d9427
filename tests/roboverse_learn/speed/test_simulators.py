"""The comparison of handlers with the simulators' own loops: it runs, and compares like with like."""

import pytest

from envs.core.errors import MissingExtraError, SimulatorError
from envs.simulators import HANDLERS
from roboverse_learn.speed import BENCHMARKS, simulators
from roboverse_learn.speed.loops import LOOPS, MujocoLoop


def test_it_is_registered_with_the_goals_that_were_promised():
    assert BENCHMARKS.entry("simulators").target == "roboverse_learn.speed.simulators"
    assert simulators.OVERHEAD_GOAL == 1.15


def test_every_simulator_of_its_own_has_a_loop():
    """``mujoco_warp`` has a benchmark of its own; a loop may wait for a simulator, never the other way."""
    assert {*HANDLERS} - {"mujoco_warp"} <= set(LOOPS)


@pytest.mark.parametrize("name", LOOPS)
def test_the_handler_ends_where_the_loop_ends(name):
    if name not in HANDLERS:
        pytest.skip(f"There is no simulator '{name}' here.")
    try:
        measurement = simulators.measure_overhead(name, turns=1, control_steps=3)
    except MissingExtraError as error:
        pytest.skip(str(error))
    assert measurement.ours_s > 0 < measurement.baseline_s
    assert str(measurement).startswith(
        f"{name}: control step of PickCube, handler / the simulator's own loop"
    )
    assert "goal ≤ 1.15" in str(measurement)


def test_other_physics_is_not_compared(monkeypatch):
    run = MujocoLoop.run
    monkeypatch.setattr(MujocoLoop, "run", lambda self, target, num_steps: run(self, target + 0.1, num_steps))
    with pytest.raises(SimulatorError, match="this is not the same physics"):
        simulators.measure_overhead("mujoco", turns=1, control_steps=3)


def test_what_is_absent_is_said_and_what_misses_its_goal_counts(monkeypatch, caplog):
    def overhead(name, *, turns):
        if name == "sapien":
            raise MissingExtraError("simulator 'sapien' needs a package")
        ratio = {"mujoco": 1.1, "pybullet": 1.3}[name]
        return simulators.Measurement(
            name=name, ours_s=ratio, baseline_s=1.0, ratio=ratio, goal="goal ≤ 1.15"
        )

    monkeypatch.setattr(simulators, "measure_overhead", overhead)
    with caplog.at_level("INFO"):
        assert simulators.main(["simulators=[mujoco,sapien]"]) == 0
    assert "sapien: not measured. simulator 'sapien' needs a package" in caplog.text
    assert simulators.main(["simulators=[mujoco,pybullet]"]) == 1
    assert simulators.main(["simulators=[sapien]"]) == 1


def test_names_are_checked(caplog):
    assert simulators.main(["simulators=[sapiens]"]) == 2
    assert "Unknown simulator with a loop of its own 'sapiens'" in caplog.text
    assert "Did you mean 'sapien'" in caplog.text

"""Conservation laws hold in every simulator, to the accuracy of its time step."""

import json

import numpy as np
import pytest

from envs.core.errors import MissingExtraError, ResultError, SimulatorError
from envs.simulators import HANDLERS
from roboverse_learn import conservation
from roboverse_learn.cli import main
from roboverse_learn.sim2sim.conservation import conservation_page as page
from roboverse_learn.sim2sim.conservation.experiments import (
    CHAIN,
    COLLISION,
    EXPERIMENTS,
    SPIN,
    deviations,
    run,
    start_of,
)
from tests.sweeps import sweep


def largest(experiment, simulator, timestep_s=0.005):
    found = deviations(run(experiment, simulator, timestep_s)[1])
    return {name: np.abs(values).max() for name, values in found.items()}


@pytest.fixture(params=sweep(HANDLERS.names(), {"mujoco"}))
def simulator(request):
    try:
        HANDLERS.get(request.param)
    except MissingExtraError as error:
        pytest.skip(str(error))
    return request.param


@pytest.mark.slow
def test_collision_conserves_momentum_and_gains_no_energy(simulator):
    seconds, found = run(COLLISION, simulator, 0.005)
    away = deviations(found)
    assert away["momentum"].max() < 1e-3
    assert away["kinetic_energy"].max() < 1e-3
    assert away["kinetic_energy"][-1] < -0.05  # the balls did collide
    assert seconds[-1] == pytest.approx(COLLISION.duration_s, rel=0.02)


def test_smaller_time_step_conserves_better():
    for experiment in (SPIN, CHAIN):
        coarse, fine = (largest(experiment, "mujoco", step) for step in (0.005, 0.0005))
        for name in ("angular_momentum", "kinetic_energy"):
            assert fine[name] < coarse[name] / 5 < 0.02, (experiment.name, name)


def test_rotation_about_the_middle_axis_is_unstable():
    """The brick turns over: otherwise the experiment would be a trivial one."""
    with HANDLERS.get("mujoco")(conservation_scene(), 1) as handler:
        handler.launch()
        handler.set_states(start_of(SPIN))
        lowest = 3.0
        for _ in range(40):
            handler.step(40)
            lowest = min(lowest, float(handler.get_states().objects["brick"].ang_vel[0, 1]))
    assert lowest < -2.0


def conservation_scene():
    from roboverse_learn.sim2sim.conservation.experiments import scene

    return scene(SPIN, 0.005)


@pytest.mark.slow
def test_page_is_a_function_of_the_results(tmp_path):
    page.write_result(tmp_path, conservation.run_on("mujoco", 0.01))
    before = page.write_page(tmp_path)
    text = before["table"].read_text()
    for experiment in EXPERIMENTS:
        assert f"| {experiment.name} | mujoco | 10 ms |" in text
    assert "% left |" in text
    contents = {path: path.read_bytes() for path in before.values()}
    assert len(contents) == 4
    page.write_page(tmp_path)
    assert {path: path.read_bytes() for path in before.values()} == contents


@pytest.mark.slow
def test_failed_simulator_is_named_on_the_page(tmp_path, monkeypatch):
    def stop(*_):
        raise SimulatorError("It stopped.")

    monkeypatch.setattr("roboverse_learn.sim2sim.conservation.experiments.run", stop)
    page.write_result(tmp_path, conservation.run_on("mujoco", 0.01))
    text = page.write_page(tmp_path)["table"].read_text()
    assert "| spin | mujoco | 10 ms | not run | not run | not run |" in text
    assert "mujoco did not run spin: It stopped." in text


def test_other_json_files_are_refused(tmp_path):
    (tmp_path / "notes.json").write_text("{}")
    with pytest.raises(ResultError, match=r"notes.json' is no result of roboverse conservation"):
        page.write_page(tmp_path)
    (tmp_path / "notes.json").write_text("{")
    with pytest.raises(ResultError, match=r"notes.json' is not a JSON file.*run again"):
        page.write_page(tmp_path)


@pytest.mark.slow
def test_command_writes_results_and_page(tmp_path, capsys):
    assert main(["conservation", "simulators=[mujoco]", "timestep_s=0.02", f"out={tmp_path}"]) == 0
    assert "collision" in capsys.readouterr().out
    values = json.loads((tmp_path / "mujoco.json").read_text())
    assert set(values["experiments"]) == {experiment.name for experiment in EXPERIMENTS}
    assert {path.suffix for path in tmp_path.iterdir()} == {".json", ".md", ".png"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["simulators=[mujco]"], "Unknown simulator 'mujco'. Did you mean 'mujoco'?"),
        (["timestep_s=0"], "timestep_s must be above 0, given 0"),
        (["timestep=0.1"], "Unknown key 'timestep' of conservation. Did you mean 'timestep_s'?"),
    ],
)
def test_invalid_settings_name_the_mistake(words, message, capsys):
    assert main(["conservation", *words]) == 2
    assert message in capsys.readouterr().err

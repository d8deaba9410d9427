"""Environments in processes: what the contract of handlers does not say."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from multiprocessing import forkserver
from pathlib import Path

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError, SimulatorError, UnknownNameError
from envs.randomization import MaterialLibrary
from envs.simulators import HANDLERS
from envs.simulators.processes import ProcessHandler, _context
from envs.tasks.pick_cube import PickCube

NUM_ENVS = 3
LIBRARY = MaterialLibrary.built_in()


@pytest.fixture(scope="module")
def scenario():
    scenario = PickCube().scenario
    cameras = tuple(dataclasses.replace(camera, width=16, height=16) for camera in scenario.cameras[:1])
    return dataclasses.replace(scenario, cameras=cameras)


@pytest.fixture(scope="module")
def both(scenario):
    """The same environments in two processes and in none."""
    apart = ProcessHandler(scenario, NUM_ENVS, num_processes=2, renderer="warp", textures=LIBRARY.texture)
    together = HANDLERS.get("mujoco")(scenario, NUM_ENVS, textures=LIBRARY.texture)
    with apart, together:
        apart.launch()
        together.launch()
        yield apart, together


def begin(*handlers):
    states = PickCube().initial_state([np.random.default_rng(i) for i in range(NUM_ENVS)])
    for handler in handlers:
        handler.set_states(states)
    return states


def test_they_move_as_without_processes(both):
    states = begin(*both)
    target = states.robots["franka"].joint_pos + 0.1
    for handler in both:
        handler.step_towards({"franka": target[1:]}, 5, [1, 2])
        handler.set_joint_targets({"franka": target[:1]}, [0])
        handler.step(10)
    ours, theirs = (handler.get_states().flatten() for handler in both)
    for key, value in theirs.items():
        assert torch.equal(ours[key], value), key


def test_they_look_as_without_processes(both):
    begin(*both)
    looks = both[0].scenario.appearance
    table = dataclasses.replace(looks.materials["table"], texture=LIBRARY.names["table"][0])
    appearance = dataclasses.replace(looks, materials={**looks.materials, "table": table}, table_yaw_rad=0.5)
    for handler in both:
        handler.set_appearance(appearance, 2)
    ours, theirs = (handler.render(None, ("rgb", "segmentation")) for handler in both)
    for kind in ("rgb", "segmentation"):
        np.testing.assert_array_equal(ours["front"][kind], theirs["front"][kind])
    assert not np.array_equal(ours["front"]["rgb"][1], ours["front"]["rgb"][2])
    assert both[0].segmentation_names == both[1].segmentation_names
    assert both[0].not_shown == both[1].not_shown


def test_snapshots_are_drawn_later_in_their_order(both):
    apart, _ = both
    begin(apart)
    now = apart.render()["front"]["rgb"]
    jobs = apart.snapshot()
    apart.step(100)
    np.testing.assert_array_equal(apart.render_jobs(jobs[::-1])["front"]["rgb"], now[::-1])
    assert apart.render_jobs([])["front"]["rgb"].shape == (0, 16, 16, 3)


def test_what_is_placed_is_placed_everywhere(both):
    apart, _ = both
    begin(apart)
    apart.set_poses({"goal": (torch.tensor([[0.1, 0.2, 0.3]]), torch.tensor([[1.0, 0.0, 0.0, 0.0]]))})
    assert apart.get_states().objects["goal"].pos.tolist() == [pytest.approx([0.1, 0.2, 0.3])] * NUM_ENVS


def test_an_error_inside_comes_out_as_it_is(both):
    apart, _ = both
    states = begin(apart)
    states.robots["franka"].joint_pos = torch.zeros((NUM_ENVS, 2), dtype=torch.float64)
    states.robots["franka"].joint_vel = torch.zeros((NUM_ENVS, 2), dtype=torch.float64)
    with pytest.raises(ConfigError, match=r"'franka' has 9 joints; the state gives 2.*environments 0 to"):
        apart.set_states(states)
    begin(apart)
    assert apart.get_states().num_envs == NUM_ENVS


def test_names_and_numbers_are_checked(scenario, both):
    with pytest.raises(UnknownNameError, match=r"Unknown simulator 'mujocko'.*Did you mean 'mujoco'"):
        ProcessHandler(scenario, 1, simulator="mujocko")
    with pytest.raises(ConfigError, match="num_processes is 1 or more, or 0 for one per core; given -1"):
        ProcessHandler(scenario, 1, num_processes=-1)
    assert ProcessHandler(scenario, 2, num_processes=8).num_processes == 2
    with pytest.raises(SimulatorError, match=r"call launch\(\) first"):
        ProcessHandler(scenario, 1).get_states()


def test_a_process_that_dies_is_named(scenario):
    with ProcessHandler(scenario, 2, num_processes=2) as handler:
        handler.launch()
        pid = handler._workers[1]._process.pid
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(
            SimulatorError, match=r"The process of environments 1 to 1 ended \(exit code -9\)"
        ):
            handler.step(1)


def test_closing_ends_processes_and_frees_their_memory(scenario):
    handler = ProcessHandler(scenario, 1)
    handler.launch()
    process, name = handler._workers[0]._process, handler._check_open().name
    handler.close()
    handler.close()
    assert process.exitcode == 0
    assert not os.path.exists(f"/dev/shm/{name}")
    with pytest.raises(SimulatorError, match="nothing after close"):
        handler.step(1)


def is_over(pid):
    """Whether a process has ended; an orphan may wait for an init that asks for no exit codes."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(") ")[1][0] == "Z"
    except OSError:
        return True


def test_they_see_what_is_so_when_they_start_and_end_with_a_killed_program(tmp_path):
    folders = [tmp_path / name for name in ("one", "two")]
    for folder in folders:
        (folder / "envs").mkdir(parents=True)  # another package of this name in the current folder
        (folder / "envs/__init__.py").write_text("raise ValueError('not this one')")
    script = Path(__file__).with_name("in_processes.py")
    environment = {**os.environ, "PYTHONPATH": str(script.parents[3]), "PYTHONSAFEPATH": "1"}
    program = subprocess.Popen(
        [sys.executable, str(script), *map(str, folders)],
        cwd=folders[0],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with program:
        assert program.stdout is not None
        found = json.loads(program.stdout.readline())
        program.kill()
    for told, folder in zip(found["told"], folders, strict=True):
        assert f"{folder.name} in {folder}, (a process of its own" in told
    (server,) = found["servers"]
    assert server["pid"] != program.pid
    assert server["has_imported"] and server["threads"] == 1
    until = time.monotonic() + 60
    while not all(map(is_over, (*found["workers"], server["pid"]))):
        assert time.monotonic() < until, f"still there: {found}"
        time.sleep(0.02)


def test_a_forked_program_starts_them_afresh(monkeypatch):
    def not_ours():
        raise ChildProcessError("No child processes")

    before = dict(os.environ)
    monkeypatch.setattr(forkserver, "ensure_running", not_ours)
    assert _context().get_start_method() == "spawn"
    assert dict(os.environ) == before

"""The SAPIEN handler beyond the contract: agreement with MuJoCo, settings, tasks."""

import dataclasses

import pytest
import torch

from envs.core.extras import install_command

pytest.importorskip("sapien", reason=f"SAPIEN is not installed: {install_command('sapien')}")

from envs.core.errors import ConfigError, SimulatorError
from envs.simulators import HANDLERS
from envs.simulators.sapien.settings import SapienSettings
from envs.tasks.pick_cube import PickCube
from tests.envs.simulators.reaching import assert_refused, launched, lid_left_alone, reach, start, with_block


def test_the_arm_moves_as_in_mujoco():
    """Same gains, limits and inertias: within a third of a degree all the way of a half-second reach."""
    ways = [reach("mujoco"), reach("sapien")]
    assert (ways[0] - ways[1])[..., :7].abs().max() < 6e-3
    assert (ways[0] - ways[1])[..., 7:].abs().max() < 1e-3


def test_the_lid_of_the_box_moves_with_the_box_and_stays_where_friction_holds_it():
    begun, before, after = lid_left_alone("sapien")
    assert before.pos[0].tolist() == begun.pos[0].float().tolist()
    assert torch.equal(after.pos, before.pos)
    assert torch.isfinite(after.joint_pos).all()


def test_threads_change_nothing():
    task = PickCube()
    ends = []
    for num_threads in (1, 2):
        with launched("sapien", task.scenario, 3, num_threads=num_threads) as handler:
            handler.set_states(start(task, 3))
            handler.step(30)
            ends.append(handler.get_states().flatten())
    for key, value in ends[0].items():
        assert torch.equal(value, ends[1][key]), key


def test_two_handlers_keep_their_own_gravity():
    task = PickCube()
    physics = dataclasses.replace(task.scenario.physics, gravity=(0.0, 0.0, 0.0))
    with (
        launched("sapien", task.scenario) as heavy,
        launched("sapien", dataclasses.replace(task.scenario, physics=physics)) as light,
    ):
        for handler, falls in ((heavy, True), (light, False), (heavy, True)):
            states = start(task)
            states.objects["cube"].pos[:] = torch.tensor([0.5, 0.5, 1.0])
            handler.set_states(states)
            handler.step(50)
            height = float(handler.get_states().objects["cube"].pos[0, 2])
            assert (height < 0.97) is falls


def test_settings_are_read_and_unknown_ones_refused():
    assert SapienSettings.of(with_block("sapien", position_iterations=20)).position_iterations == 20
    assert_refused("sapien", "iterations")
    with pytest.raises(ConfigError, match="velocity_iterations of sapien is 1 to 255, given 0"):
        SapienSettings(velocity_iterations=0)


def test_nothing_runs_before_launch_or_after_close():
    handler = HANDLERS.get("sapien")(PickCube().scenario, 1)
    with pytest.raises(SimulatorError, match=r"does not run: call launch\(\) first"):
        handler.get_states()
    handler.launch()
    handler.close()
    with pytest.raises(SimulatorError, match="nothing after close"):
        handler.step(1)


def test_joints_of_another_number_are_refused():
    task = PickCube()
    with launched("sapien", task.scenario) as handler:
        states = start(task)
        states.robots["franka"].joint_pos = torch.zeros((1, 3))
        with pytest.raises(ConfigError, match="'franka' has 9 joints; the state gives 3"):
            handler.set_states(states)

"""Physics of many worlds: what they share, and that nothing else is shared."""

import logging

import mujoco
import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError, SimulatorError, UnknownNameError
from envs.simulators.mujoco.handler import MujocoHandler
from envs.simulators.mujoco_warp.device import Device
from envs.simulators.mujoco_warp.handler import MujocoWarpHandler
from envs.simulators.mujoco_warp.settings import WarpSettings
from envs.simulators.mujoco_warp.worlds import put_model
from tests.envs.simulators.mujoco_warp.conftest import NUM_ENVS, scene, starts


def everything(handler, env_ids=None):
    return torch.cat([v.flatten(1) for v in handler.get_states(env_ids).flatten().values()], dim=1)


def moving(states):
    """Targets a little away from where the joints are, and the cubes in the air."""
    states.objects["cube"].pos[:, 2] += 0.01
    robot = states.robots["franka"]
    robot.joint_target = robot.joint_pos + 0.05
    return states


def test_views_are_the_simulators_own_memory(handler):
    handler.set_states(starts())
    handler.views.qpos[2, 0] = 0.25
    assert handler.get_states([2]).robots["franka"].joint_pos[0, 0] == 0.25
    before = handler.views.qpos.clone()
    handler.step(5)
    assert not torch.equal(handler.views.qpos, before)


@pytest.mark.slow
def test_a_world_is_the_same_whatever_their_number_is(handler):
    """Bit-identical on a CPU: 60 steps in which the cube lands and the arm moves."""
    start = moving(starts())
    handler.set_states(start)
    handler.step(60)
    expected = everything(handler)
    for count in (1, 3):
        with MujocoWarpHandler(scene(), count) as other:
            other.launch()
            other.set_states(start.select(range(count)))
            other.step(60)
            assert torch.equal(everything(other), expected[:count])


def test_the_physics_is_that_of_the_other_simulator(handler):
    """Single precision against double: 1e-4 after 0.1 s with a landing cube and a moving arm."""
    start = moving(starts())
    with MujocoHandler(scene(), NUM_ENVS, num_threads=1) as double:
        double.launch()
        for simulator in (handler, double):
            simulator.set_states(start)
            simulator.step(50)
        ours, theirs = (s.get_states().flatten() for s in (handler, double))
    for key in ("robots/franka/joint_pos", "robots/franka/ee_pos", "objects/cube/pos"):
        assert (ours[key] - theirs[key]).abs().max() < 1e-4, key


@pytest.mark.parametrize("cause", ["state", "targets"])
def test_diverged_world_is_reset_alone_and_counted(handler, caplog, cause):
    start = moving(starts())
    handler.set_states(start)
    handler.step(10)
    expected = everything(handler)
    handler.set_states(start)
    begun, counted = everything(handler), handler.num_resets.clone()
    if cause == "state":
        handler.views.qvel[1, 3] = torch.nan
    else:
        handler.set_joint_targets({"franka": np.full((1, 9), np.nan)}, [1])
    with caplog.at_level(logging.WARNING):
        handler.step(10)
    after = everything(handler)
    assert torch.equal(after[[0, 2, 3]], expected[[0, 2, 3]])
    assert torch.equal(after[1], begun[1])
    assert (handler.num_resets - counted).tolist() == [0, 1, 0, 0]
    assert "The state of environments [1] was no longer finite" in caplog.text
    handler.step(10)
    assert torch.equal(everything(handler), everything(handler))
    assert torch.isfinite(everything(handler)).all()


def test_frozen_world_is_not_checked(handler):
    """What happens to it while others step is undone, whatever it is."""
    handler.set_states(starts())
    handler.views.qvel[3, 0] = torch.inf
    counted = handler.num_resets.clone()
    handler.step(3, [0, 1])
    assert torch.equal(handler.num_resets, counted)
    assert handler.views.qvel[3, 0] == torch.inf


@pytest.mark.slow
@pytest.mark.parametrize(("setting", "size"), [("njmax", 8), ("nconmax", 1)])
def test_a_buffer_that_is_too_small_is_an_error_that_names_it(setting, size):
    with MujocoWarpHandler(scene(**({"njmax": 64} | {setting: size})), 2) as small:
        small.launch()
        small.set_states(starts(2))
        wanted = (
            rf"Add simulator_settings\.{setting}={2 * size} \(it is {size}\) to the command, or say so in"
        )
        with pytest.raises(SimulatorError, match=rf"too small for environments .*{wanted}"):
            small.step(20)


def test_settings_are_checked():
    with pytest.raises(
        UnknownNameError, match=r"setting of simulator=mujoco_warp 'njmx'.*Did you mean 'njmax'"
    ):
        WarpSettings.of(scene(njmx=3))
    with pytest.raises(ConfigError, match="nconmax must be at least 1, given 0"):
        WarpSettings(nconmax=0)
    with pytest.raises(SimulatorError, match=r"no device 'cuda:77'.*Valid: auto, cpu"):
        Device("cuda:77")


def test_what_it_has_no_code_for_is_said():
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body()
    body.add_freejoint()
    body.add_geom(size=(0.1, 0, 0))
    spec.option.solver = mujoco.mjtSolver.mjSOL_PGS
    with (
        Device("cpu").scope(),
        pytest.raises(SimulatorError, match=r"SOL_PGS.*Use simulator=mujoco, or change"),
    ):
        put_model(spec.compile())


def test_a_simulator_that_was_not_launched_is_an_error():
    with pytest.raises(SimulatorError, match=r"does not run: call launch\(\) first"):
        MujocoWarpHandler(scene(), 1).step(1)

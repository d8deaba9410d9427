"""What the handler says and hands out, beside what every simulator promises."""

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError, UnknownNameError
from envs.simulators import HANDLERS, RENDERERS
from envs.simulators.mujoco.render import RenderJob
from envs.simulators.mujoco.render_warp import WarpRenderer
from envs.simulators.mujoco_warp.handler import MujocoWarpHandler
from envs.simulators.mujoco_warp.settings import WarpSettings
from envs.simulators.mujoco_warp.snapshots import Snapshots
from envs.tasks.nut_assembly import NutAssembly
from tests.envs.simulators.mujoco_warp.conftest import NUM_ENVS, images_of, scene, starts


def test_it_is_registered_and_steps_together():
    assert HANDLERS.get("mujoco_warp") is MujocoWarpHandler
    assert MujocoWarpHandler.steps_together
    assert MujocoWarpHandler.dtype == torch.float32
    assert not HANDLERS.get("mujoco").steps_together


def test_buffers_are_sized_by_what_moves():
    """One robot and one cube: 32 contacts each, four rows to a contact; the marker does not move."""
    sized = WarpSettings.of(scene())
    assert (sized.nconmax, sized.njmax) == (64, 256)
    given = WarpSettings.of(scene(nconmax=10))
    assert (given.nconmax, given.njmax) == (10, 40)
    assert WarpSettings.of(scene(njmax=7)).njmax == 7


def test_what_a_file_describes_may_touch_in_more_places():
    sized = WarpSettings.of(NutAssembly().scenario)
    assert (sized.nconmax, sized.njmax) == (160, 640)


def test_what_is_only_seen_is_not_simulated(handler):
    assert handler.physics_model.ngeom < handler.model.ngeom
    assert handler.physics_model.nq == handler.model.nq


def test_a_snapshot_is_a_sequence_of_jobs(handler):
    handler.set_states(starts())
    shots = handler.snapshot([3, 1])
    assert len(shots) == 2
    assert isinstance(shots[1], RenderJob)
    np.testing.assert_array_equal(shots[1].qpos, handler.views.qpos[1].double())
    assert shots[1].qpos.dtype == np.float64
    part = shots[1:]
    assert isinstance(part, Snapshots)
    assert torch.equal(part.qpos[0], shots.qpos[1])
    assert [job.appearance for job in shots] == [handler.scenario.appearance] * 2
    again = Snapshots.of(list(shots), handler.device)
    assert torch.equal(again.qpos, shots.qpos)
    assert torch.equal(again.mocap_quat, shots.mocap_quat)
    assert Snapshots.of(shots, handler.device) is shots


def test_fixed_things_are_moved_in_mid_episode(handler):
    handler.set_states(starts())
    place, turn = torch.tensor([[0.1, 0.2, 0.3]]), torch.tensor([[0.0, 1.0, 0.0, 0.0]])
    qpos = handler.views.qpos.clone()
    handler.set_poses({"goal": (place, turn)}, [2])
    goal = handler.get_states().objects["goal"]
    torch.testing.assert_close(goal.pos[2], place[0])
    torch.testing.assert_close(goal.rot[2], turn[0])
    torch.testing.assert_close(goal.pos[1], starts().objects["goal"].pos[1].float())
    assert torch.equal(handler.views.qpos, qpos)
    with pytest.raises(UnknownNameError, match=r"fixed object or marker 'goel'.*Did you mean 'goal'"):
        handler.set_poses({"goel": (place, turn)}, [2])


def test_a_state_of_another_robot_is_refused(handler):
    states = starts()
    states.robots["franka"].joint_pos = torch.zeros((NUM_ENVS, 7))
    with pytest.raises(ConfigError, match="'franka' has 9 joints; the state gives 7"):
        handler.set_states(states)


def test_another_renderer_renders_its_snapshots(monkeypatch):
    """Renderers of the CPU get what they always get; their images become tensors on request."""
    monkeypatch.setattr(RENDERERS, "get", lambda name: WarpRenderer)
    with MujocoWarpHandler(scene(), 1, renderer="gl", textures=images_of, num_threads=1) as handler:
        handler.launch()
        handler.set_states(starts(1))
        images = handler.render(["front"])["front"]["rgb"]
        tensors = handler.render_tensors(None, ["front"])["front"]["rgb"]
        assert tensors.device == handler.device
        np.testing.assert_array_equal(tensors, images)
        assert handler.segmentation_names[0] == "franka"
        assert handler.not_shown == WarpRenderer.not_shown

"""Physics of one simulator, images of another: resolution of names, and rendering."""

import dataclasses

import numpy as np
import pytest
import torch

import envs
from envs.core.errors import ConfigError, MissingExtraError, SimulatorError, UnknownNameError
from envs.simulators import HANDLERS, RENDERERS, hybrid
from envs.simulators.hybrid import HybridHandler, drawing_simulator, make_handler
from envs.simulators.mujoco_warp.handler import MujocoWarpHandler
from envs.tasks.pick_cube import PickCube

KINDS = ("rgb", "depth", "segmentation")
NUM_ENVS = 3


def small_scene():
    scenario = PickCube().scenario
    cameras = tuple(dataclasses.replace(camera, width=32, height=32) for camera in scenario.cameras)
    return dataclasses.replace(scenario, cameras=cameras)


def starts(seed=0, count=NUM_ENVS):
    return PickCube().initial_state([np.random.default_rng(seed + i) for i in range(count)])


def launched(handler):
    handler.launch()
    return handler


@pytest.fixture(scope="module", params=[name for name in HANDLERS if name != "mujoco"])
def drawing(request):
    """A simulator other than the one that the pairs below take physics from."""
    try:
        with launched(HybridHandler(small_scene(), 1, renderer=request.param)) as handler:
            handler.render()
    except (MissingExtraError, SimulatorError) as error:
        pytest.skip(str(error))
    return request.param


@pytest.fixture(scope="module")
def pair(drawing):
    with launched(HybridHandler(small_scene(), NUM_ENVS, renderer=drawing)) as handler:
        yield handler


@pytest.fixture(scope="module")
def alone(drawing):
    simulator, renderer = drawing_simulator("mujoco", drawing)
    with launched(make_handler(simulator, small_scene(), NUM_ENVS, renderer=renderer or drawing)) as handler:
        yield handler


def draw(handler, *args):
    return handler.render(["front"], KINDS, *args)["front"]


def assert_same(first, second):
    for kind in KINDS:
        np.testing.assert_array_equal(first[kind], second[kind])


def test_images_are_those_of_the_rendering_simulator(pair, alone):
    pair.set_states(starts())
    pair.step(30)
    alone.set_states(pair.get_states().to(alone.device, alone.dtype))
    assert_same(draw(pair), draw(alone))
    assert_same(draw(pair, [2]), draw(alone, [2]))
    assert pair.segmentation_names == alone.segmentation_names
    assert pair.not_shown == alone.not_shown


def test_looks_are_those_of_each_environment(pair, alone):
    base = pair.scenario.appearance
    table = dataclasses.replace(base.materials["table"], rgb=(0.1, 0.7, 0.1), texture=None)
    green = dataclasses.replace(base, materials={**base.materials, "table": table})
    for handler in (pair, alone):
        handler.set_states(starts().to(handler.device, handler.dtype))
        plain = draw(handler)["rgb"]
        handler.set_appearance(green, 1)
    coloured, expected = draw(pair)["rgb"], draw(alone)["rgb"]
    for handler in (pair, alone):
        handler.set_appearance(base, 1)
    np.testing.assert_array_equal(coloured, expected)
    np.testing.assert_array_equal(coloured[[0, 2]], plain[[0, 2]])
    assert np.abs(coloured[1].astype(int) - plain[1]).mean() > 5


def test_drawing_changes_nothing_of_physics(pair):
    with launched(make_handler("mujoco", small_scene(), NUM_ENVS, renderer="warp")) as physics:
        for handler in (physics, pair):
            handler.set_states(starts(5))
            handler.set_joint_targets({"franka": starts(6).robots["franka"].joint_pos})
        for _ in range(3):
            physics.step(5)
            pair.step(5)
            draw(pair)
        expected = physics.get_states().flatten()
    for key, value in pair.get_states().flatten().items():
        assert torch.equal(value, expected[key]), key


def test_a_snapshot_is_of_its_moment(pair):
    pair.set_states(starts())
    jobs, before = pair.snapshot([0, 2]), draw(pair, [0, 2])
    pair.set_states(starts(9))
    assert not np.array_equal(draw(pair, [0, 2])["depth"], before["depth"])
    assert_same(pair.render_jobs(jobs, ["front"], KINDS)["front"], before)
    swapped = pair.render_jobs([jobs[1], jobs[0]], ["front"], KINDS)["front"]
    assert_same({kind: image[::-1] for kind, image in swapped.items()}, before)
    last = pair.render_jobs(jobs[1:], ["front"], KINDS)["front"]
    assert_same(last, {kind: image[1:] for kind, image in before.items()})
    with pytest.raises(IndexError, match="There are 2 snapshots, and none at 2"):
        jobs[2]
    assert pair.render_jobs(jobs[:0], ["front"])["front"]["rgb"].shape == (0, 32, 32, 3)


@pytest.mark.slow
def test_portions_do_not_show(monkeypatch, drawing, pair):
    pair.set_states(starts())
    whole = draw(pair)
    monkeypatch.setattr(hybrid, "MAX_DRAWN_AT_ONCE", 2)
    with launched(HybridHandler(small_scene(), NUM_ENVS, renderer=drawing)) as handler:
        handler.set_states(starts())
        assert handler.drawing.num_envs == 2
        assert_same(draw(handler), whole)


def test_objects_moved_during_an_episode_are_rendered_in_place(pair):
    pair.set_states(starts())
    before = draw(pair)
    places = torch.tensor([0.1, 0.2, 0.3]).tile(NUM_ENVS, 1)
    pair.set_poses({"goal": (places, torch.tensor([1.0, 0.0, 0.0, 0.0]).tile(NUM_ENVS, 1))})
    assert not np.array_equal(draw(pair)["segmentation"], before["segmentation"])


def test_a_simulators_own_renderers_make_no_pair():
    assert set(HANDLERS.get("mujoco").own_renderers) <= set(RENDERERS)
    for simulator in ("mujoco", "mujoco_warp"):
        assert drawing_simulator(simulator, "gl") == (simulator, "gl")
        assert drawing_simulator(simulator, simulator) == (simulator, "warp")
        handler = make_handler(simulator, small_scene(), 1, renderer=simulator)
        assert type(handler) is HANDLERS.get(simulator)
        assert handler.renderer_name == "warp"


def test_another_simulators_name_makes_a_pair():
    assert drawing_simulator("mujoco_warp", "mujoco") == ("mujoco", "warp")
    handler = make_handler("mujoco_warp", small_scene(), 2, renderer="mujoco")
    assert isinstance(handler, HybridHandler)
    assert (handler.renderer_name, handler.dtype, handler.steps_together) == ("mujoco", torch.float32, True)


def test_model_renderer_serves_simulators_without_one(monkeypatch):
    monkeypatch.setattr(MujocoWarpHandler, "own_renderers", ())
    assert drawing_simulator("mujoco_warp", "gl") == ("mujoco", "gl")
    assert drawing_simulator("mujoco_warp", "mujoco_warp") == ("mujoco_warp", None)


def test_an_unknown_pair_is_refused_by_name():
    with pytest.raises(
        UnknownNameError, match=r"Unknown renderer 'mujocco'. Did you mean 'mujoco'\? Valid: f"
    ):
        make_handler("mujoco_warp", small_scene(), 1, renderer="mujocco")
    with pytest.raises(UnknownNameError, match=r"Unknown simulator 'sapein'"):
        make_handler("sapein", small_scene(), 1, renderer="mujoco")


def test_rendering_after_close_is_an_error():
    handler = launched(HybridHandler(small_scene(), 1))
    jobs = handler.snapshot()
    handler.close()
    with pytest.raises(SimulatorError, match="nothing can be rendered after close"):
        handler.render_jobs(jobs)


@pytest.mark.slow
def test_episodes_do_not_depend_on_the_renderer():
    hashes, images = {}, {}
    for renderer in ("warp", "mujoco_warp"):
        env = envs.make_vec("PickCube", 2, split="train", level=3, renderer=renderer, image_size=32)
        try:
            env.reset(seed=3)
            hashes[renderer] = [env.initial_state_hash(i) for i in range(2)]
            images[renderer] = env.observe()["observation.images.front"].astype(int)
            assert env.renderer == renderer
            assert env.render()[0].shape == (32, 32, 3)
        finally:
            env.close()
    assert hashes["warp"] == hashes["mujoco_warp"]
    assert np.abs(images["warp"] - images["mujoco_warp"]).mean() < 1.0


def test_the_errors_of_physics_come_through(pair):
    states = starts()
    states.robots["franka"].joint_pos = states.robots["franka"].joint_pos[:, :5]
    with pytest.raises(ConfigError, match="'franka' has 9 joints; the state gives 5"):
        pair.set_states(states)

"""Images of many worlds at once: those of the other simulator, and each world's own looks."""

import dataclasses

import numpy as np
import pytest
import torch

from envs.core.errors import SimulatorError
from envs.randomization import Randomizer
from envs.simulators.mujoco.handler import MujocoHandler
from envs.simulators.mujoco_warp.device import Device
from envs.simulators.mujoco_warp.handler import MujocoWarpHandler
from envs.simulators.mujoco_warp.textures import TextureTable
from envs.simulators.mujoco_warp.tracer import by_tiles
from envs.tasks.pick_cube import PickCube
from tests.envs.simulators.mujoco_warp.conftest import NUM_ENVS, images_of, scene, starts

KINDS = ("rgb", "depth", "segmentation")
EVERY_CHANNEL = ("environment", "camera", "lighting")


@pytest.fixture(scope="module")
def looks():
    """Four different samples of level 3."""
    scenario = PickCube().scenario
    randomizer = Randomizer(
        scenario.appearance, scenario.cameras, channels=EVERY_CHANNEL, split="train", seed=0
    )
    return [randomizer.appearance(int(episode)) for episode in randomizer.split.episodes[:NUM_ENVS]]


@pytest.fixture
def dressed(handler, looks):
    handler.set_states(starts())
    for env_id, look in enumerate(looks):
        handler.set_appearance(look, env_id)
    yield handler
    for env_id in range(NUM_ENVS):
        handler.set_appearance(handler.scenario.appearance, env_id)


def test_they_are_those_of_the_other_simulator(dressed, looks):
    """Single-precision positions move a silhouette by far less than a pixel: one pixel in a thousand may
    fall on its other side. All others agree to two grey levels and a tenth of a millimetre."""
    with MujocoHandler(scene(), NUM_ENVS, textures=images_of, num_threads=1) as other:
        other.launch()
        other.set_states(starts())
        for env_id, look in enumerate(looks):
            other.set_appearance(look, env_id)
        theirs = other.render(None, KINDS)["front"]
    ours = dressed.render(None, KINDS)["front"]
    differs = np.abs(ours["rgb"].astype(int) - theirs["rgb"]).max(-1) > 2
    differs |= np.abs(ours["depth"] - theirs["depth"]) > 1e-4
    differs |= ours["segmentation"] != theirs["segmentation"]
    assert differs.mean() < 1e-3
    assert not np.array_equal(ours["rgb"][0], ours["rgb"][1])


def test_rays_go_tile_by_tile():
    assert by_tiles(3, 2).tolist() == [0, 1, 2, 3, 4, 5]
    first, second = [*range(16), *range(17, 33)], [16, 33]
    assert by_tiles(17, 2).tolist() == first + second
    below = 16 * 16
    assert by_tiles(16, 17)[below:].tolist() == list(range(below, below + 16))


@pytest.mark.slow
def test_cameras_of_any_size_match_the_reference_renderer():
    """Two images of which no side is whole tiles, one beside the other in the tracer's buffers."""
    scenario = scene()
    wide = dataclasses.replace(scenario.cameras[0], width=50, height=30)
    tall = dataclasses.replace(scenario.cameras[0], name="tall", width=20, height=41)
    scenario = dataclasses.replace(scenario, cameras=(wide, tall))
    images = []
    for simulator in (MujocoWarpHandler, MujocoHandler):
        with simulator(scenario, 2) as handler:
            handler.launch()
            handler.set_states(starts(2))
            images.append(handler.render(None, KINDS))
    for camera, shape in ((wide, (2, 30, 50)), (tall, (2, 41, 20))):
        ours, theirs = images[0][camera.name], images[1][camera.name]
        assert ours["segmentation"].shape == shape
        assert (ours["segmentation"] != theirs["segmentation"]).mean() < 2e-3
        assert (np.abs(ours["rgb"].astype(int) - theirs["rgb"]).max(-1) > 2).mean() < 2e-3
        assert (np.abs(ours["depth"] - theirs["depth"]) > 1e-4).mean() < 2e-3


def test_an_image_depends_on_its_world_alone(dressed):
    together = dressed.render()["front"]["rgb"]
    np.testing.assert_array_equal(dressed.render(env_ids=[1, 3])["front"]["rgb"], together[[1, 3]])
    np.testing.assert_array_equal(dressed.render(env_ids=[2])["front"]["rgb"], together[[2]])
    np.testing.assert_array_equal(dressed.render()["front"]["rgb"], together)


def test_more_jobs_than_worlds_are_rendered_in_batches(dressed):
    jobs = [*dressed.snapshot(), *dressed.snapshot([2, 0])]
    images = dressed.render_jobs(jobs)["front"]["rgb"]
    np.testing.assert_array_equal(images[NUM_ENVS:], images[[2, 0]])


def test_a_snapshot_is_of_its_moment_and_of_its_looks(dressed):
    shots = dressed.snapshot([1, 2])
    before = dressed.render_jobs(shots)["front"]["rgb"]
    dressed.step(30)
    dressed.set_appearance(dressed.scenario.appearance, 1)
    np.testing.assert_array_equal(dressed.render_jobs(shots)["front"]["rgb"], before)
    np.testing.assert_array_equal(dressed.render_jobs(shots[1:])["front"]["rgb"], before[1:])
    assert not np.array_equal(dressed.render(env_ids=[1])["front"]["rgb"][0], before[0])


def test_images_stay_on_the_device_and_go_where_they_are_wanted(dressed):
    expected = dressed.render(None, KINDS)["front"]
    film = torch.zeros((NUM_ENVS, 3, 64, 64, 3), dtype=torch.uint8, device=dressed.device)
    depth = torch.zeros((NUM_ENVS, 64, 64), device=dressed.device)
    ids = torch.zeros((NUM_ENVS, 64, 64), dtype=torch.int32, device=dressed.device)
    out = {"front": {"rgb": film[:, 1], "depth": depth, "segmentation": ids}}
    images = dressed.render_tensors(None, ["front"], KINDS, out=out)
    assert images["front"]["depth"] is depth
    np.testing.assert_array_equal(film[:, 1].cpu(), expected["rgb"])
    np.testing.assert_array_equal(depth.cpu(), expected["depth"])
    np.testing.assert_array_equal(ids.cpu(), expected["segmentation"])
    assert not film[:, [0, 2]].any()


def test_the_table_turns_in_the_image_and_not_under_the_cube(dressed, looks):
    before = dressed.views.mocap_quat.clone()
    turned = dataclasses.replace(looks[0], table_yaw_rad=0.7)
    flat = dressed.render(env_ids=[0])["front"]["rgb"]
    dressed.set_appearance(turned, 0)
    assert not np.array_equal(dressed.render(env_ids=[0])["front"]["rgb"], flat)
    assert torch.equal(dressed.views.mocap_quat, before)


def test_materials_share_one_table_that_forgets_the_longest_unused():
    import warp as wp

    table = TextureTable([], images_of, 3, Device("cpu"))
    a, b, none = table.ids_of(["a", "b", None], set())
    assert (a != b, none) == (True, -1)
    assert table.ids_of(["b", "a", "b"], set()) == [b, a, b]
    (c,) = table.ids_of(["c"], {"a"})
    assert table.ids_of(["d"], {"a", "c"}) == [b], "nobody wears b"
    assert len(table) == 3
    assert isinstance(table.array, wp.array)
    with pytest.raises(SimulatorError, match=r"more than 3 different.*\['num_textures'\] to at least 4"):
        table.ids_of(["e"], {"a", "c", "d"})
    assert c != a

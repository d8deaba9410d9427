"""Images of a GPU's physics: those of the ray tracer there, and of every renderer beside it."""

import subprocess
import sys
from contextlib import closing

import numpy as np
import pytest
import torch
import warp as wp

import envs
from envs.core.errors import MissingExtraError, SimulatorError
from envs.randomization import Randomizer
from envs.simulators import HANDLERS, RENDERERS
from envs.spec import EnvSpec
from envs.tasks.pick_cube import PickCube
from tests.envs.simulators.mujoco_warp.conftest import NUM_ENVS, images_of, scene, starts

pytestmark = pytest.mark.gpu

KINDS = ("rgb", "depth", "segmentation")
CAMERAS = ("front", "wrist")
ON_THE_CPU = ("mujoco", *(name for name in RENDERERS if name != "warp"))
"""Renderers beside the GPU's ray tracer; ``mujoco`` is the same ray tracer on the CPU."""

PROBE = """
import envs
env = envs.make_vec("PickCube", 1, simulator="mujoco", renderer="{renderer}", image_size=32)
env.reset_envs([0], env.split_indices[:1])
env.render()
"""


def skip_without_cpu_tracer():
    if not wp.is_cpu_available():
        pytest.skip("Warp has no CPU compiler here (warp-clang)")


@pytest.fixture(scope="module")
def gpu():
    with HANDLERS.get("mujoco_warp")(scene(device="cuda"), NUM_ENVS, textures=images_of) as handler:
        handler.launch()
        handler.set_states(starts())
        yield handler


@pytest.fixture(scope="module")
def looks():
    """Four different samples of level 3."""
    scenario = PickCube().scenario
    channels = ("environment", "camera", "lighting")
    randomizer = Randomizer(scenario.appearance, scenario.cameras, channels=channels, split="train", seed=0)
    return [randomizer.appearance(int(episode)) for episode in randomizer.split.episodes[:NUM_ENVS]]


def differing(ours, theirs):
    """Returns the share of the pixels that differ by more than three grey levels."""
    return (np.abs(ours.astype(int) - theirs).max(-1) > 3).mean()


def drawn(handler, looks):
    """Draws every modality of the same moment in these looks, on the CPU."""
    handler.set_states(starts())
    for env_id, look in enumerate(looks):
        handler.set_appearance(look, env_id)
    return handler.render(None, KINDS)["front"]


def test_images_are_those_of_the_cpu(gpu, looks):
    """The GPU filters textures with eight bits and rounds fast: three grey levels, one pixel in a hundred."""
    skip_without_cpu_tracer()
    with HANDLERS.get("mujoco")(scene(), NUM_ENVS, textures=images_of, num_threads=1) as cpu:
        cpu.launch()
        theirs = drawn(cpu, looks)
    ours = drawn(gpu, looks)
    assert differing(ours["rgb"], theirs["rgb"]) < 1e-2
    assert (np.abs(ours["depth"] - theirs["depth"]) > 1e-3).mean() < 1e-2
    assert (ours["segmentation"] != theirs["segmentation"]).mean() < 1e-2
    assert not np.array_equal(ours["rgb"][0], ours["rgb"][1])


def test_graph_renders_the_same_as_single_launches(gpu):
    """A graph renders all worlds, and subsets run without one; a graph renders new states."""
    for seed in (0, 50):
        gpu.set_states(starts(seed=seed))
        for env_id in range(NUM_ENVS):
            gpu.set_appearance(gpu.scenario.appearance, env_id)
        together = gpu.render_tensors(None, ["front"], KINDS)["front"]
        alone = gpu.render(["front"], KINDS, [2])["front"]
        for kind in KINDS:
            assert together[kind].is_cuda
            np.testing.assert_array_equal(alone[kind][0], together[kind][2].cpu())
        if seed == 0:
            first = together["rgb"].clone()
    assert not torch.equal(first, together["rgb"])


@pytest.mark.parametrize("level", [0, 3])
def test_every_camera_shows_the_scene_in_every_modality(level):
    env = envs.make_vec("PickCube", 3, level=level, simulator="mujoco_warp", cameras=CAMERAS, image_size=48)
    with closing(env):
        env.reset_envs(np.arange(3), env.split_indices[:3])
        seen = env.observe()
        images = env.handler.render(None, KINDS)
        names = env.handler.segmentation_names
    assert tuple(images) == CAMERAS
    for camera in CAMERAS:
        kinds = images[camera]
        assert (kinds["rgb"].shape, kinds["rgb"].dtype) == ((3, 48, 48, 3), np.uint8)
        assert (kinds["depth"].shape, kinds["depth"].dtype) == ((3, 48, 48), np.float32)
        assert (kinds["segmentation"].shape, kinds["segmentation"].dtype) == ((3, 48, 48), np.int32)
        assert kinds["rgb"].std() > 5 and np.ptp(kinds["depth"]) > 0.05
        assert kinds["segmentation"].min() >= -1 and kinds["segmentation"].max() < len(names)
        assert differing(seen[f"observation.images.{camera}"], kinds["rgb"]) < 1e-2
    cube = images["front"]["segmentation"] == names.index("cube")
    assert cube.any(axis=(1, 2)).all()
    assert {"franka", "table"} <= {names[index] for index in np.unique(images["front"]["segmentation"])}


def ends_the_process(renderer):
    """Whether a renderer's driver ends the process, which it does where a context cannot be made."""
    done = subprocess.run(
        [sys.executable, "-c", PROBE.format(renderer=renderer)], capture_output=True, check=False, timeout=120
    )
    return done.returncode < 0


@pytest.mark.parametrize("renderer", ON_THE_CPU)
def test_a_renderer_beside_the_gpu_shows_what_the_ray_tracer_does(renderer):
    if renderer == "mujoco":
        skip_without_cpu_tracer()
    found = {}
    try:
        (HANDLERS if renderer == "mujoco" else RENDERERS).get(renderer)
        if renderer != "mujoco" and ends_the_process(renderer):
            pytest.skip(f"renderer={renderer} ends the process here")
        for name in (renderer, "warp"):
            env = envs.make_vec("PickCube", 2, simulator="mujoco_warp", renderer=name, image_size=64)
            with closing(env):
                assert env.handler.device.type == "cuda"
                env.reset_envs(np.arange(2), env.split_indices[:2])
                found[name] = env.handler.render(None, KINDS)["front"]
                names = env.handler.segmentation_names
    except (MissingExtraError, SimulatorError) as error:
        pytest.skip(str(error))
    ours, theirs = found["warp"], found[renderer]
    assert theirs["rgb"].dtype == np.uint8 and theirs["rgb"].std() > 5
    assert (theirs["segmentation"] == names.index("cube")).any()
    agree = ours["segmentation"] == theirs["segmentation"]
    assert agree.mean() >= 0.97
    assert (np.abs(ours["depth"] - theirs["depth"]) < 0.01)[agree].mean() >= 0.97


def test_agents_see_images_that_stay_on_the_gpu():
    spec = EnvSpec(task="control/cartpole", simulator="mujoco_warp", image_size=64)
    env = spec.make_torch(4, observation="pixels", num_frames=2, bank_size=8)
    with closing(env):
        before = env.reset()
        step = env.step(torch.ones(4, 1, device="cuda"))
        assert step.obs.is_cuda and step.obs.dtype == torch.uint8 and step.obs.shape == (4, 6, 64, 64)
        assert step.obs[:, :3].equal(before[:, 3:]) and not step.obs[:, 3:].equal(before[:, 3:])
        saved = env.state_dict()
        after = env.step(torch.ones(4, 1, device="cuda")).obs
        assert env.load_state_dict(saved).equal(saved["frames"])
        again = env.step(torch.ones(4, 1, device="cuda")).obs
        assert (after.int() - again.int()).abs().float().mean() < 1.0

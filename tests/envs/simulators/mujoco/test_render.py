"""What renderers share: formulas worked out by hand, a stage that is dressed and undressed, threads."""

import copy
import dataclasses
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from envs.core.errors import ConfigError, SimulatorError
from envs.mjcf.model import LEAST_LIGHTS, TEXTURE_SIZE, build_model
from envs.scenario import Appearance, GeomCfg, LightCfg, SurfaceMaterial
from envs.scenario.places import places_of
from envs.simulators import RENDERERS
from envs.simulators.mujoco import render_filament, render_gl, render_warp
from envs.simulators.mujoco.handler import MujocoHandler
from envs.simulators.mujoco.render import (
    AMBIENT_FRACTION,
    RenderJob,
    Stage,
    metres_of_reversed_depth,
    shininess,
    specular_strength,
    texture_of,
)
from envs.simulators.mujoco.render_warp import WarpRenderer
from envs.tasks.pick_cube import PickCube

SCENARIO = dataclasses.replace(
    PickCube().scenario,
    cameras=tuple(dataclasses.replace(c, width=48, height=48) for c in PickCube().scenario.cameras),
)
BASE = SCENARIO.appearance


@pytest.mark.parametrize(
    ("roughness", "expected"),
    [(1.0, 0.0), (0.5, 30.0 / 128.0), (0.8, (2.0 / 0.4096 - 2.0) / 128.0), (0.1, 1.0), (0.0, 1.0)],
)
def test_shininess_of_a_roughness(roughness, expected):
    """α = r², exponent 2/α² − 2, over 128: r = 0.5 gives 2/0.0625 − 2 = 30."""
    assert shininess(roughness) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("roughness", "specular", "expected"),
    [(1.0, 1.0, 0.02), (0.5, 0.5, 0.16), (0.5, 0.0, 0.0), (0.0, 1.0, 1.0)],
)
def test_specular_strength(roughness, specular, expected):
    """0.08 s / (4 α²): r = 0.5, s = 0.5 gives 0.04 / 0.25."""
    assert specular_strength(roughness, specular) == pytest.approx(expected)


def test_metres_of_a_reversed_depth_buffer():
    """Between 1 m and 3 m: 1 is the near plane, 0 nothing, a half 3 / (1 + 0.5 · 2) = 1.5 m."""
    metres = metres_of_reversed_depth(np.array([1.0, 0.5, 0.0], np.float32), 1.0, 3.0)
    np.testing.assert_allclose(metres, [1.0, 1.5, 0.0])
    assert metres.dtype == np.float32


def test_reversed_depth_is_inverted_over_its_range():
    near, far = 0.01, 40.0
    metres = np.geomspace(near, 0.99 * far, 50)
    buffer = near * (far - metres) / (metres * (far - near))
    np.testing.assert_allclose(metres_of_reversed_depth(buffer, near, far), metres, rtol=1e-5)


def test_no_texture_is_white():
    assert (texture_of(None, lambda name, size: np.zeros((size, size, 3), np.uint8)) == 255).all()
    assert (texture_of("oak", None) == 255).all()
    calls = []
    texture_of("oak", lambda name, size: calls.append((name, size)) or np.zeros((size, size, 3), np.uint8))
    assert calls == [("oak", TEXTURE_SIZE)]


@pytest.fixture(scope="module")
def model():
    return build_model(SCENARIO)


@pytest.fixture
def stage(model):
    return Stage(model, SCENARIO)


def job(model, appearance=BASE):
    data = mujoco.MjData(model)
    return RenderJob(data.qpos.copy(), data.mocap_pos.copy(), data.mocap_quat.copy(), appearance)


def test_a_stage_is_dressed_once_for_one_appearance(model, stage):
    assert stage.pose(job(model)) is True
    assert stage.pose(job(model)) is False
    assert stage.pose(job(model, dataclasses.replace(BASE, table_yaw_rad=1.0))) is True


def test_a_stage_leaves_the_handlers_model_alone(model, stage):
    fields = ("mat_rgba", "light_diffuse", "light_active", "cam_pos", "mat_texrepeat", "mat_texid")
    before = {name: getattr(model, name).copy() for name in fields}
    camera = dataclasses.replace(SCENARIO.cameras[0], pos=(2.0, 0.0, 1.0))
    looks = Appearance(
        materials={"table": SurfaceMaterial(texture="oak", rgb=(0.1, 0.2, 0.3), size_m=0.5)},
        cameras={"front": camera},
        lights=(LightCfg(intensity=0.2),),
    )
    stage.pose(job(model, looks))
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(model, name), value, err_msg=name)


def test_a_texture_is_repeated_by_its_size(model, stage):
    """A table of 1.6 m carries an image of 0.4 m four times; the ground of 6 m an image of 2 m thrice."""
    looks = dataclasses.replace(
        BASE,
        materials={
            "table": SurfaceMaterial(texture="oak", size_m=0.4),
            "ground": SurfaceMaterial(texture="sand", size_m=2.0),
        },
    )
    stage.pose(job(model, looks))
    np.testing.assert_allclose(stage.model.material("table").texrepeat, (4.0, 4.0))
    np.testing.assert_allclose(stage.model.material("ground").texrepeat, (3.0, 3.0))
    assert stage.surface_textures == {"table": "oak", "wall": None, "ground": "sand"}
    rgb = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
    assert stage.model.mat_texid[stage.model.material("table").id, rgb] == stage.model.texture("table").id
    stage.pose(job(model))
    assert stage.surface_textures == dict.fromkeys(("table", "wall", "ground"))
    assert stage.model.mat_texid[stage.model.material("table").id, rgb] == -1


def test_more_lights_than_the_scene_was_made_for_are_refused(model, stage):
    with pytest.raises(ConfigError, match=r"9 lights was given, and the scene was made for 8\. Give its"):
        stage.pose(job(model, dataclasses.replace(BASE, lights=(LightCfg(),) * 9)))


def test_lights_are_set_and_put_out_again(model, stage):
    lamp = LightCfg(kind="area", pos=(0.0, 0.0, 3.0), color=(1.0, 0.5, 0.0), intensity=0.5)
    far = LightCfg(direction=(0.0, 3.0, -4.0), intensity=0.8, cast_shadow=True)
    stage.pose(job(model, dataclasses.replace(BASE, lights=(far, lamp))))
    ours = stage.model
    assert ours.light_active.tolist() == [True, True] + [False] * (LEAST_LIGHTS - 2)
    kinds = mujoco.mjtLightType
    assert ours.light_type[:2].tolist() == [int(kinds.mjLIGHT_DIRECTIONAL), int(kinds.mjLIGHT_SPOT)]
    np.testing.assert_allclose(ours.light_dir[0], (0.0, 0.6, -0.8))
    np.testing.assert_allclose(ours.light_diffuse[1], (0.5, 0.25, 0.0))
    np.testing.assert_allclose(
        ours.light_ambient[1], AMBIENT_FRACTION * np.array([0.5, 0.25, 0.0]), rtol=1e-6
    )
    assert ours.light_castshadow[:2].tolist() == [True, False]
    stage.pose(job(model))
    assert ours.light_active.sum() == len(BASE.lights)


def test_a_scene_without_lights_is_not_dark(model):
    bare = dataclasses.replace(SCENARIO, appearance=Appearance())
    stage = Stage(model, bare)
    stage.pose(job(model, Appearance()))
    assert stage.model.light_active.sum() == 1
    assert stage.model.light_castshadow[0]


def test_the_table_turns_on_the_stage(model, stage):
    stage.pose(job(model, dataclasses.replace(BASE, table_yaw_rad=np.pi / 2)))
    matrix = stage.data.geom("table").xmat.reshape(3, 3)
    np.testing.assert_allclose(matrix, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)


@pytest.fixture(scope="module")
def handler():
    with MujocoHandler(SCENARIO, 4, renderer="warp", num_threads=2) as handler:
        handler.launch()
        handler.set_states(PickCube().initial_state([np.random.default_rng(i) for i in range(4)]))
        yield handler


@pytest.mark.slow
def test_two_threads_render_the_same_images_as_one(handler):
    """An image depends on its job alone: many at once, one after the other, from two callers."""
    jobs = handler.snapshot()
    together = handler.render_jobs(jobs)["front"]["rgb"]
    alone = np.concatenate([handler.render_jobs([job])["front"]["rgb"] for job in jobs])
    np.testing.assert_array_equal(together, alone)
    with ThreadPoolExecutor(2) as pool:
        drawn = list(pool.map(lambda _: handler.render_jobs(jobs)["front"]["rgb"], range(4)))
    for images in drawn:
        np.testing.assert_array_equal(images, together)


def test_removed_furniture_leaves_no_trace(handler):
    """Rooms with and without furniture have trees and textures of their own."""
    (bare,) = handler.snapshot([0])
    stool = GeomCfg(shape="box", size=(0.2, 0.2, 0.3), pos=(0.0, 0.0, 0.3), rgba=(0.9, 0.1, 0.9, 1.0))
    room = PickCube().scenario.room
    assert room is not None
    looks = dataclasses.replace(
        bare.appearance,
        furniture={place: (stool,) for place in places_of(room.half_size_m)},
        materials={"table": SurfaceMaterial(texture="any")},
    )
    furnished = dataclasses.replace(bare, appearance=looks)
    renderer = WarpRenderer(handler.model, SCENARIO, textures=_noise, num_threads=1)
    cameras = tuple(camera.name for camera in SCENARIO.cameras)
    drawn = [renderer.render([job], cameras, ("rgb",)) for job in (bare, furnished, bare, furnished)]
    for camera in cameras:
        first, second, third, fourth = (images[camera]["rgb"] for images in drawn)
        np.testing.assert_array_equal(first, third)
        np.testing.assert_array_equal(second, fourth)
    assert any((drawn[0][camera]["rgb"] != drawn[1][camera]["rgb"]).any() for camera in cameras)
    renderer.close()


def test_an_image_does_not_depend_on_the_textures_that_are_kept(handler, monkeypatch):
    (bare,) = handler.snapshot([0])
    jobs = []
    for table, wall in (("a", "b"), ("b", "c"), ("c", "a"), ("a", "b")):
        materials = {"table": SurfaceMaterial(texture=table), "wall": SurfaceMaterial(texture=wall)}
        jobs.append(
            dataclasses.replace(bare, appearance=dataclasses.replace(bare.appearance, materials=materials))
        )
    made, drawn, counts = [], [], []

    def textures(name, size):
        made.append(name)
        return _noise(name, size)

    for kept in (1, 32):
        monkeypatch.setattr(render_warp, "KEPT_TEXTURES", kept)
        made.clear()
        renderer = WarpRenderer(handler.model, SCENARIO, textures=textures, num_threads=1)
        images = [renderer.render([job], ("front",), ("rgb",))["front"]["rgb"] for job in jobs]
        renderer.close()
        drawn.append(np.concatenate(images))
        counts.append(len(made))
    assert counts[0] > 3 == counts[1]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    np.testing.assert_array_equal(drawn[1][0], drawn[1][3])
    assert (drawn[1][0] != drawn[1][1]).any()


def _noise(name, size):
    return np.random.default_rng(len(name) + ord(name[0])).integers(0, 255, (size, size, 3), dtype=np.uint8)


def test_a_snapshot_is_of_its_moment(handler):
    jobs = handler.snapshot([1])
    before = copy.deepcopy(jobs[0])
    handler.step(20)
    np.testing.assert_array_equal(jobs[0].qpos, before.qpos)
    assert not np.array_equal(handler.snapshot([1])[0].qpos, before.qpos)


def test_simplified_meshes_look_like_the_full_ones(handler):
    """Fewer triangles may move an outline by a pixel: in the mean, less than two grey levels."""
    with MujocoHandler(SCENARIO, 1, num_threads=1, simplify_meshes=False) as full:
        full.launch()
        kinds = ("rgb", "segmentation")
        jobs = full.snapshot()
        theirs, ours = (h.render_jobs(jobs, None, kinds)["front"] for h in (full, handler))
    assert np.abs(theirs["rgb"].astype(float) - ours["rgb"]).mean() < 2.0
    assert (theirs["segmentation"] == ours["segmentation"]).mean() > 0.99


def test_a_simulator_that_was_not_launched_is_an_error():
    handler = MujocoHandler(SCENARIO, 1)
    with pytest.raises(SimulatorError, match=r"does not run: call launch\(\) first"):
        handler.step(1)


def test_without_warps_compiler_the_message_names_the_package_and_the_other_renderer(model, monkeypatch):
    monkeypatch.setattr("warp.is_cpu_available", lambda: False)
    renderer = WarpRenderer(model, SCENARIO, num_threads=1)
    message = r"renderer=warp needs Warp's compiler .* no warp-clang in '.*warp/bin'.* warp-lang.*renderer=gl"
    with pytest.raises(SimulatorError, match=message):
        renderer.render([job(model)], ("front",), ("rgb",))
    renderer.close()


def test_without_opengl_the_message_names_packages_and_the_other_renderer(model, monkeypatch):
    def nothing(name):
        raise ImportError(f"no {name}")

    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(render_gl.importlib, "import_module", nothing)
    message = r"renderer=gl found no OpenGL \(egl: no mujoco\.egl; osmesa: no .*libegl1.*renderer=warp"
    with pytest.raises(SimulatorError, match=message):
        render_gl.GlRenderer(model, SCENARIO)


@pytest.mark.parametrize("given", [None, "egl"])
def test_a_backend_that_fails_does_not_choose_the_library_of_the_next_one(given, monkeypatch):
    seen = []

    def backend(name):
        seen.append((name, os.environ.get("PYOPENGL_PLATFORM"), "OpenGL.GL" in sys.modules))
        if name == "mujoco.egl":  # it chooses a library, and then there is none
            os.environ["PYOPENGL_PLATFORM"] = "egl"
            monkeypatch.setitem(sys.modules, "OpenGL.GL", SimpleNamespace())
            raise ImportError("no EGL")
        return SimpleNamespace(GLContext=lambda width, height: (name, width, height))

    for name in [name for name in sys.modules if name.startswith("OpenGL")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)
    if given is not None:
        monkeypatch.setenv("PYOPENGL_PLATFORM", given)
    monkeypatch.setattr(render_gl.importlib, "import_module", backend)
    assert render_gl._open_context(4, 3) == ("mujoco.osmesa", 4, 3)
    assert seen == [("mujoco.egl", given, False), ("mujoco.osmesa", given, False)]


@pytest.mark.parametrize(("library", "reason"), [(None, "there is no libvulkan"), ("x", "finds no device")])
def test_missing_vulkan_is_an_error_with_the_reason(model, monkeypatch, library, reason):
    monkeypatch.setattr(render_filament.ctypes.util, "find_library", lambda name: library)
    monkeypatch.setattr(render_filament.ctypes, "CDLL", lambda name: None)
    monkeypatch.setattr(render_filament, "_count_devices", lambda vulkan: 0)
    with pytest.raises(
        SimulatorError, match=f"renderer=filament needs a Vulkan driver.*{reason}.*renderer=warp"
    ):
        render_filament.FilamentRenderer(model, SCENARIO)


def test_mujocos_renderers_say_what_they_cannot_show():
    for name in ("warp", "gl", "filament"):
        assert set(RENDERERS.get(name).not_shown) <= {"metallic", "lamp_shape"}
        assert RENDERERS.entry(name).summary

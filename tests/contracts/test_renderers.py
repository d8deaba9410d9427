"""What every registered renderer promises, on one scene whose distances can be worked out by hand."""

import dataclasses
import math
from functools import cache

import mujoco
import numpy as np
import pytest

from envs.core.errors import MissingExtraError, SimulatorError
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.scenario import CameraCfg, LightCfg, SurfaceMaterial
from envs.simulators import RENDERERS
from envs.simulators.mujoco.render import RenderJob
from envs.tasks.pick_cube import PickCube
from envs.tasks.tabletop import TABLETOP_LOOKS

ALL = ("top", "slant", "high")
MODALITIES = ("rgb", "depth", "segmentation")
EXACT = ("warp", "gl", "pybullet", "newton")
"""Renderers whose images depend on the job alone, bit by bit."""

DITHER = 0.8
"""Filament adds noise below one grey level: the mean difference that is no difference."""

PLACE = (0.35, 0.35)
"""Where the top camera looks: empty table, unless the cube is put there."""

TOP_HEIGHT_M, TOP_FOVY_DEG, TOP_SIZE = 1.2, 20.0, (96, 64)
SCENARIO = dataclasses.replace(
    PickCube().scenario,
    cameras=(
        CameraCfg(
            name="top",
            pos=(*PLACE, TOP_HEIGHT_M),
            look_at=(*PLACE, 0.0),
            fovy_deg=TOP_FOVY_DEG,
            width=TOP_SIZE[0],
            height=TOP_SIZE[1],
        ),
        CameraCfg(name="slant", pos=(1.0, -0.6, 0.9), look_at=(0.4, 0.2, 0.0), width=64, height=64),
        CameraCfg(
            name="high", pos=(-0.12, 0.0, 2.5), look_at=(-0.12, 0.0, 0.0), fovy_deg=60.0, width=64, height=64
        ),
    ),
)
BASE = TABLETOP_LOOKS
LAMP = LightCfg(kind="area", pos=(0.0, 0.5, 2.5), intensity=0.6)


def images_of(name, size):
    """An 8 by 8 checker; anything else is plain red."""
    if name == "checker":
        squares = (np.indices((size, size)) // (size // 8)).sum(0) % 2
        return np.repeat((255 * squares).astype(np.uint8)[..., None], 3, axis=-1)
    return np.broadcast_to(np.array([255, 0, 0], np.uint8), (size, size, 3)).copy()


@pytest.fixture(scope="module")
def model():
    return build_model(SCENARIO)


@pytest.fixture(scope="module")
def warp(model):
    renderer = RENDERERS.get("warp")(model, SCENARIO, textures=images_of, num_threads=1)
    yield renderer
    renderer.close()


@pytest.fixture(scope="module", params=RENDERERS.names())
def renderer(request, model, warp):
    if request.param == "warp":
        yield warp
        return
    try:
        renderer = RENDERERS.get(request.param)(model, SCENARIO, textures=images_of, num_threads=1)
    except (MissingExtraError, SimulatorError) as error:
        pytest.skip(str(error))
    yield renderer
    renderer.close()


def name_of(renderer):
    class_name = type(renderer).__name__
    return next(name for name in RENDERERS if str(RENDERERS.entry(name).target).endswith(f":{class_name}"))


@pytest.fixture(scope="module")
def job(model):
    """Makes a job: the robot at rest, the cube at ``cube``, with the given appearance."""
    layout = layout_of(model, SCENARIO)
    data = mujoco.MjData(model)
    cube, goal = layout.objects

    def make(appearance=BASE, cube_at=(0.0, 0.3, 0.02)):
        qpos = data.qpos.copy()
        qpos[layout.robots[0].qpos] = SCENARIO.robots[0].default_qpos
        qpos[cube.root_qpos : cube.root_qpos + 3] = cube_at
        mocap_pos = data.mocap_pos.copy()
        mocap_pos[goal.mocap] = (0.0, -0.3, 0.2)
        for index in range(model.nbody):
            if model.body_mocapid[index] >= 0 and index != model.body("goal").id:
                mocap_pos[model.body_mocapid[index]] = model.body_pos[index]
        mocap_quat = np.tile([1.0, 0.0, 0.0, 0.0], (model.nmocap, 1))
        return RenderJob(qpos, mocap_pos, mocap_quat, appearance)

    return make


@pytest.fixture(scope="module")
def plain(job):
    """Draws the scene as it is, once for each renderer."""
    return cache(lambda renderer: draw(renderer, job()))


def draw(renderer, *jobs):
    return renderer.render(jobs, ALL, MODALITIES)


def with_material(surface, **changes):
    material = dataclasses.replace(BASE.materials[surface], **changes)
    return dataclasses.replace(BASE, materials={**BASE.materials, surface: material})


def middle(image):
    """Mean of the four pixels round the optical axis."""
    height, width = image.shape[:2]
    return image[height // 2 - 1 : height // 2 + 1, width // 2 - 1 : width // 2 + 1].mean(axis=(0, 1))


def same(a, b):
    return all(np.array_equal(a[camera][kind], b[camera][kind]) for camera in ALL for kind in MODALITIES)


def difference(a, b, camera="top"):
    """Mean absolute difference of two colour images, grey levels."""
    return np.abs(a[camera]["rgb"].astype(float) - b[camera]["rgb"]).mean()


def test_shapes_and_types(renderer, job):
    out = draw(renderer, job(), job())
    assert list(out) == list(ALL)
    for camera in SCENARIO.cameras:
        size = (2, camera.height, camera.width)
        images = out[camera.name]
        assert list(images) == list(MODALITIES)
        assert (images["rgb"].shape, images["rgb"].dtype) == ((*size, 3), np.uint8)
        assert (images["depth"].shape, images["depth"].dtype) == (size, np.float32)
        assert (images["segmentation"].shape, images["segmentation"].dtype) == (size, np.int32)
        assert np.isfinite(images["depth"]).all()
        assert (images["depth"] >= 0.0).all()
        assert images["segmentation"].min() >= -1
        assert images["segmentation"].max() < len(renderer.segmentation_names)


def test_nothing_to_draw_gives_no_image(renderer):
    out = draw(renderer)
    assert out["top"]["rgb"].shape == (0, TOP_SIZE[1], TOP_SIZE[0], 3)


def test_only_requested_modalities_are_rendered(renderer, job):
    everything = draw(renderer, job())
    one = renderer.render([job()], ("slant",), ("rgb",))
    assert list(one) == ["slant"]
    assert list(one["slant"]) == ["rgb"]
    assert difference(one, everything, "slant") <= (0.0 if name_of(renderer) in EXACT else DITHER)


def test_names_are_those_of_the_scene(renderer):
    assert renderer.segmentation_names == ("franka", "cube", "goal", "table", "wall", "ground", "furniture")


def test_the_same_job_gives_the_same_image(renderer, job):
    first, second = draw(renderer, job()), draw(renderer, job())
    if name_of(renderer) in EXACT:
        assert same(first, second)
    for camera in ALL:
        np.testing.assert_array_equal(first[camera]["depth"], second[camera]["depth"])
        np.testing.assert_array_equal(first[camera]["segmentation"], second[camera]["segmentation"])
        assert difference(first, second, camera) < DITHER


@pytest.mark.slow
def test_results_are_in_the_order_of_the_jobs(renderer, job):
    here, there = job(cube_at=(*PLACE, 0.02)), job(with_material("table", rgb=(0.2, 0.2, 0.8)))
    forward, backward = draw(renderer, here, there, here), draw(renderer, there, here)
    for camera in ALL:
        for kind in ("depth", "segmentation"):
            images = forward[camera][kind]
            np.testing.assert_array_equal(images[0], images[2])
            np.testing.assert_array_equal(images[0], backward[camera][kind][1])
            np.testing.assert_array_equal(images[1], backward[camera][kind][0])
    assert (
        difference({"top": {"rgb": forward["top"]["rgb"][0]}}, {"top": {"rgb": forward["top"]["rgb"][1]}}) > 5
    )


def test_depth_is_metres_along_the_optical_axis(renderer, job):
    """The table top is z = 0: under the top camera 1.2 m away everywhere, not only in the middle."""
    depth = draw(renderer, job())["top"]["depth"][0]
    np.testing.assert_allclose(depth, TOP_HEIGHT_M, atol=2e-3)


def test_depth_in_the_middle_of_a_slanting_view_is_the_distance(renderer, job):
    slant = SCENARIO.cameras[1]
    expected = math.dist(slant.pos, slant.look_at)
    assert middle(draw(renderer, job())["slant"]["depth"][0]) == pytest.approx(expected, abs=5e-3)


def test_the_cube_has_its_size_and_height(renderer, job):
    """4 cm at 1.16 m, through a lens of 64 / (2 tan 10°) = 181.5 pixels: 6.26 pixels wide."""
    images = draw(renderer, job(cube_at=(*PLACE, 0.02)))["top"]
    cube = images["segmentation"][0] == renderer.segmentation_names.index("cube")
    assert middle(cube) == 1.0
    np.testing.assert_allclose(images["depth"][0][cube], TOP_HEIGHT_M - 0.04, atol=3e-3)
    assert 25 <= cube.sum() <= 56
    rows, columns = np.nonzero(cube)
    assert np.ptp(rows) + 1 in (6, 7)
    assert np.ptp(columns) + 1 in (6, 7)


def test_the_cube_is_red_and_the_marker_green(renderer, job):
    images = draw(renderer, job())
    for name, channel in (("cube", 0), ("goal", 1)):
        mask = images["high"]["segmentation"][0] == renderer.segmentation_names.index(name)
        colour = images["high"]["rgb"][0][mask].mean(axis=0)
        assert mask.any()
        assert colour[channel] > 1.2 * np.delete(colour, channel).max()


def test_segmentation_and_depth_agree_with_the_ray_tracers(renderer, warp, job):
    ours, theirs = draw(renderer, job()), draw(warp, job())
    for camera in ALL:
        agree = ours[camera]["segmentation"] == theirs[camera]["segmentation"]
        assert agree.mean() >= 0.97, camera
        near = np.abs(ours[camera]["depth"] - theirs[camera]["depth"]) < 0.01
        assert near[agree].mean() >= 0.97, camera


CHANGES = {
    "colour of the table": (with_material("table", rgb=(0.1, 0.1, 0.9)), "top", 5.0),
    "texture of the table": (with_material("table", texture="red"), "top", 5.0),
    "colour of the ground": (with_material("ground", rgb=(0.9, 0.1, 0.1)), "high", 2.0),
    "roughness of the table": (with_material("table", roughness=0.2, specular=1.0), "high", 0.2),
    "darker light": (
        dataclasses.replace(BASE, lights=(dataclasses.replace(BASE.lights[0], intensity=0.3),)),
        "top",
        5.0,
    ),
    "coloured light": (
        dataclasses.replace(BASE, lights=(dataclasses.replace(BASE.lights[0], color=(1.0, 0.3, 0.3)),)),
        "top",
        5.0,
    ),
    "another lamp": (dataclasses.replace(BASE, lights=(*BASE.lights, LAMP)), "top", 2.0),
    "turned table": (dataclasses.replace(BASE, table_yaw_rad=0.7), "high", 1.0),
    "reflection of objects": (dataclasses.replace(BASE, object_reflection=(0.2, 1.0, 0.0)), "high", 0.01),
}


NEEDS = {"roughness of the table": "roughness", "reflection of objects": "object_reflection"}
"""What a renderer has to show to show a change, where not every one does."""


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGES)
def test_appearance_can_be_set_and_reset(renderer, plain, job, change):
    appearance, camera, least = CHANGES[change]
    if NEEDS.get(change) in renderer.not_shown:
        pytest.skip(f"renderer={name_of(renderer)} says that it does not show {NEEDS[change]}")
    before, changed, after = plain(renderer), draw(renderer, job(appearance)), draw(renderer, job())
    assert difference(before, changed, camera) > least
    if name_of(renderer) in EXACT:
        assert same(before, after)
    else:
        assert difference(before, after, camera) < DITHER


def test_darker_light_is_darker(renderer, job):
    bright, dark = (
        draw(renderer, job(CHANGES[change][0] if change else BASE))["top"]["rgb"].mean()
        for change in (None, "darker light")
    )
    assert dark < 0.8 * bright


def test_a_camera_that_is_moved_sees_from_there(renderer, job):
    top = dataclasses.replace(SCENARIO.cameras[0], pos=(*PLACE, 1.5))
    out = draw(renderer, job(dataclasses.replace(BASE, cameras={"top": top})))
    assert middle(out["top"]["depth"][0]) == pytest.approx(1.5, abs=3e-3)
    slant = SCENARIO.cameras[1]
    assert middle(out["slant"]["depth"][0]) == pytest.approx(math.dist(slant.pos, slant.look_at), abs=5e-3)


def corners_of_the_table(renderer, images):
    """Shares of table where only the straight table reaches, and where only one turned by 45° does."""
    table = renderer.segmentation_names.index("table")
    segmentation = images["high"]["segmentation"][0]
    pixels_per_metre = 32 / (2.5 * math.tan(math.radians(30.0)))
    corner, side = round(0.73 * pixels_per_metre), round(0.98 * pixels_per_metre)
    corners = [segmentation[32 + sy * corner, 32 + sx * corner] for sx in (-1, 1) for sy in (-1, 1)]
    sides = [segmentation[32 + dy, 32 + dx] for dx, dy in ((side, 0), (-side, 0), (0, side), (0, -side))]
    return np.mean(np.array(corners) == table), np.mean(np.array(sides) == table)


def test_the_table_turns_and_its_collision_box_is_never_seen(renderer, job):
    """The box below the cube stays where it is; were it rendered, the corners would stay too."""
    assert corners_of_the_table(renderer, draw(renderer, job())) == (1.0, 0.0)
    turned = job(dataclasses.replace(BASE, table_yaw_rad=math.pi / 4))
    corners, sides = corners_of_the_table(renderer, draw(renderer, turned))
    assert corners == 0.0
    assert sides >= 0.75  # the robot may hide one


def crossings(renderer, job, size_m):
    """How often a row and a column of the top image change between dark and bright."""
    looks = with_material("table", texture="checker", rgb=(1.0, 1.0, 1.0), size_m=size_m, specular=0.0)
    image = draw(renderer, job(looks))["top"]["rgb"][0].mean(axis=-1)
    dark, bright = np.percentile(image, (10, 90))
    assert bright - dark > 60
    binary = image > (dark + bright) / 2
    assert 0.25 < binary.mean() < 0.75
    row, column = (np.abs(np.diff(line.astype(int))).sum() for line in (binary[20], binary[:, 20]))
    return row, column


def test_a_checker_has_squares_of_the_right_size(renderer, job):
    """The view is 0.42 m high and 0.63 m wide; an image of 0.8 m has squares of 0.1 m."""
    row, column = crossings(renderer, job, 0.8)
    assert row in (5, 6, 7)
    assert column in (3, 4, 5)
    row, column = crossings(renderer, job, 1.6)
    assert row in (2, 3, 4)
    assert column in (1, 2, 3)


@pytest.mark.parametrize("quality", ["metallic", "lamp_shape"])
def test_not_shown_is_honest(renderer, job, quality):
    """What a renderer says it cannot show changes no bit, and what it does not name is seen."""
    lamps = tuple(dataclasses.replace(LAMP, radius_m=r, length_m=m) for r, m in ((0.05, 1.0), (0.3, 2.0)))
    looks = {
        "metallic": [with_material("table", metallic=m, roughness=0.3) for m in (0.0, 1.0)],
        "lamp_shape": [dataclasses.replace(BASE, lights=(*BASE.lights, lamp)) for lamp in lamps],
    }[quality]
    first, second = (draw(renderer, job(look)) for look in looks)
    if quality in renderer.not_shown:
        assert difference(first, second, "high") < (1e-9 if name_of(renderer) in EXACT else DITHER)
    else:
        assert difference(first, second, "high") > 1.0


def test_a_missing_material_is_plain(renderer, job):
    bare = dataclasses.replace(BASE, materials={"table": SurfaceMaterial(rgb=(0.2, 0.9, 0.2))})
    image = draw(renderer, job(bare))["top"]["rgb"][0].reshape(-1, 3).mean(axis=0)
    assert image[1] > 1.5 * max(image[0], image[2])

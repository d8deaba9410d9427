"""SAPIEN's images beyond the contract of renderers."""

import dataclasses

import numpy as np
import pytest

from envs.core.extras import install_command

pytest.importorskip("sapien", reason=f"SAPIEN is not installed: {install_command('sapien')}")

from envs.core.errors import SimulatorError
from envs.mjcf.model import build_model
from envs.scenario import CameraCfg, GeomCfg, LightCfg, ObjectCfg
from envs.simulators import RENDERERS
from envs.simulators.mujoco.render import RenderJob
from envs.simulators.sapien.visuals import VisualFactory
from envs.tasks.pick_cube import PickCube
from envs.tasks.tabletop import TABLETOP_LOOKS

SHAPES = {"box": (0.1, 0.1, 0.1), "sphere": (0.1,), "cylinder": (0.1, 0.1), "capsule": (0.05, 0.05)}


def scenario():
    objects = tuple(
        ObjectCfg(
            name=shape,
            geoms=(GeomCfg(shape=shape, size=size, rgba=(0.1, 0.2, 0.9, 1.0)),),
            kind="marker",
            pos=(0.3 * index - 0.45, 0.3, 0.1),
        )
        for index, (shape, size) in enumerate(SHAPES.items())
    )
    camera = CameraCfg(
        name="top", pos=(0.0, 0.3, 1.5), look_at=(0.0, 0.3, 0.0), up=(0.0, 1.0, 0.0), width=96, height=48
    )
    return dataclasses.replace(PickCube().scenario, objects=objects, cameras=(camera,), robots=())


@pytest.fixture(scope="module")
def model():
    return build_model(scenario())


@pytest.fixture(scope="module")
def renderer(model):
    def checker(name, size):
        squares = (np.indices((size, size)) // (size // 2)).sum(0) % 2
        return np.repeat((255 * squares).astype(np.uint8)[..., None], 3, axis=-1)

    try:
        renderer = RENDERERS.get("sapien")(model, scenario(), textures=checker)
    except SimulatorError as error:
        pytest.skip(str(error))
    yield renderer
    renderer.close()


def draw(renderer, model, looks=TABLETOP_LOOKS):
    mocap = np.argsort(model.body_mocapid)[-model.nmocap :]
    job = RenderJob(np.zeros(model.nq), model.body_pos[mocap], model.body_quat[mocap], looks)
    return renderer.render([job], ("top",), ("rgb", "depth", "segmentation"))["top"]


def test_every_shape_is_seen_with_its_size_and_colour(renderer, model):
    images = draw(renderer, model)
    for index, name in enumerate(SHAPES):
        mask = images["segmentation"][0] == renderer.segmentation_names.index(name)
        assert mask.sum() >= 16, name
        colour = images["rgb"][0][mask].mean(axis=0)
        assert colour[2] > 1.5 * colour[0], name
        focal = 24 / np.tan(np.pi / 8)
        column = 48 + (0.3 * index - 0.45) * focal / 1.4
        assert np.nonzero(mask)[1].mean() == pytest.approx(column, abs=3), name


def test_rebuilt_surface_keeps_its_name(renderer, model):
    """The size of an image is part of the mesh."""
    before = draw(renderer, model)["segmentation"]
    table = dataclasses.replace(TABLETOP_LOOKS.materials["table"], texture="checker", size_m=0.37)
    looks = dataclasses.replace(TABLETOP_LOOKS, materials={**TABLETOP_LOOKS.materials, "table": table})
    changed = draw(renderer, model, looks)
    np.testing.assert_array_equal(changed["segmentation"], before)
    assert changed["rgb"].std() > 20
    after = draw(renderer, model)
    np.testing.assert_array_equal(after["segmentation"], before)


def test_more_lights_of_a_kind_than_there_are_is_said(renderer, model):
    lights = tuple(LightCfg(cast_shadow=True, intensity=0.2) for _ in range(2))
    with pytest.raises(SimulatorError, match="one distant light that casts shadows and one that does not"):
        draw(renderer, model, dataclasses.replace(TABLETOP_LOOKS, lights=lights))
    draw(renderer, model)


def test_a_lamp_is_as_bright_at_the_table_as_it_says(renderer, model):
    """Straight below a lamp of intensity 0.5, chalk of colour 0.5: a quarter, and the ambient share."""
    table = dataclasses.replace(
        TABLETOP_LOOKS.materials["table"], rgb=(0.5, 0.5, 0.5), roughness=1.0, specular=0.0
    )
    lamp = LightCfg(kind="area", pos=(0.0, 0.3, 3.0), intensity=0.5)
    looks = dataclasses.replace(
        TABLETOP_LOOKS, materials={**TABLETOP_LOOKS.materials, "table": table}, lights=(lamp,)
    )
    middle = draw(renderer, model, looks)["rgb"][0][22:26, 46:50].mean() / 255
    assert middle == pytest.approx(0.5 * 0.5 * 1.3, rel=0.15)


def test_closing_twice_is_harmless(model, renderer):
    other = type(renderer)(model, scenario())
    assert isinstance(other._factory, VisualFactory)
    other.close()
    other.close()


def test_what_is_kept_of_a_closed_renderer_changes_no_bit(model, renderer):
    drawn, dim = [], dataclasses.replace(TABLETOP_LOOKS, lights=(LightCfg(intensity=0.2),))
    for looks in (TABLETOP_LOOKS, dim, TABLETOP_LOOKS):
        fresh = type(renderer)(model, scenario())
        drawn.append(draw(fresh, model, looks))
        fresh.close()
    first, other, last = drawn
    assert all(np.array_equal(first[kind], last[kind]) for kind in ("rgb", "depth", "segmentation"))
    assert not np.array_equal(first["rgb"], other["rgb"])

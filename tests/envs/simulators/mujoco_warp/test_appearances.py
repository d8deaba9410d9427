"""Appearances as rows of the tracer's arrays."""

import dataclasses

import mujoco
import numpy as np
import pytest
import torch

from envs.mjcf.model import LEAST_LIGHTS, build_model
from envs.scenario import LightCfg, SurfaceMaterial
from envs.simulators.mujoco.render import Stage
from envs.simulators.mujoco.render_warp import ready_for_tracing
from envs.simulators.mujoco_warp.appearances import PER_WORLD, AppearanceWriter
from envs.simulators.mujoco_warp.device import Device
from envs.simulators.mujoco_warp.textures import TextureTable
from envs.simulators.mujoco_warp.worlds import put_model
from tests.envs.simulators.mujoco_warp.conftest import images_of, scene

NUM_WORLDS = 3
RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)


@pytest.fixture(scope="module")
def stage():
    scenario = scene()
    stage = Stage(build_model(scenario), scenario)
    ready_for_tracing(stage.model)
    return stage


@pytest.fixture
def writer(stage):
    device = Device("cpu")
    with device.scope():
        model = put_model(stage.model, dict.fromkeys(PER_WORLD, NUM_WORLDS))
    writer = AppearanceWriter(stage, model, NUM_WORLDS, TextureTable([], images_of, 4, device), device)
    writer.fields = {name: device.tensor(getattr(model, name)) for name in PER_WORLD}
    return writer


def base():
    return scene().appearance


def with_table(**changes):
    look = base()
    material = dataclasses.replace(look.materials["table"], **changes)
    return dataclasses.replace(look, materials={**look.materials, "table": material})


def material(stage, name):
    return stage.model.material(name).id


def test_every_world_has_its_own_material(stage, writer):
    writer.write([with_table(rgb=(0.1, 0.2, 0.3)), base(), with_table(rgb=(0.7, 0.8, 0.9), roughness=0.1)])
    table = material(stage, "table")
    colours = writer.fields["mat_rgba"][:, table, :3]
    torch.testing.assert_close(colours[0], torch.tensor([0.1, 0.2, 0.3]))
    torch.testing.assert_close(colours[1], torch.tensor(base().materials["table"].rgb))
    torch.testing.assert_close(colours[2], torch.tensor([0.7, 0.8, 0.9]))
    shine = writer.fields["mat_shininess"][:, table]
    assert shine[2] > shine[0] == shine[1]


def test_textures_are_places_in_one_table(stage, writer):
    oak, stone = with_table(texture="oak"), with_table(texture="stone")
    writer.write([oak, stone, base()])
    table, wall = material(stage, "table"), material(stage, "wall")
    places = writer.fields["mat_texid"][:, table, RGB].tolist()
    assert places[0] != places[1]
    assert places[2] == -1
    assert writer.fields["mat_texid"][:, wall, RGB].tolist() == [-1, -1, -1]
    writer.write([stone])
    assert writer.fields["mat_texid"][:, table, RGB].tolist() == [places[1], places[1], -1]


def test_lights_and_cameras_and_the_table_top(stage, writer):
    front = scene().cameras[0]
    lamp = LightCfg(kind="area", pos=(0.0, 0.5, 2.5), intensity=0.5, color=(1.0, 0.5, 0.0))
    look = dataclasses.replace(
        base(),
        lights=(base().lights[0], lamp),
        cameras={front.name: dataclasses.replace(front, pos=(0.5, 0.5, 1.5))},
        table_yaw_rad=np.pi / 2,
    )
    writer.write([base(), look])
    fields = writer.fields
    assert fields["light_active"][:2].sum(-1).tolist() == [1, 2]
    assert fields["light_active"].shape == (NUM_WORLDS, LEAST_LIGHTS)
    torch.testing.assert_close(fields["light_diffuse"][1, 1], torch.tensor([0.5, 0.25, 0.0]))
    torch.testing.assert_close(fields["light_pos"][1, 1], torch.tensor(lamp.pos))
    camera = stage.model.camera(front.name).id
    torch.testing.assert_close(fields["cam_pos"][1, camera], torch.tensor([0.5, 0.5, 1.5]))
    torch.testing.assert_close(fields["cam_pos"][0, camera], torch.tensor(front.pos))
    half = float(np.sqrt(0.5))
    torch.testing.assert_close(writer.table_quat[1], torch.tensor([half, 0.0, 0.0, half]))
    torch.testing.assert_close(writer.table_quat[0], torch.tensor([1.0, 0.0, 0.0, 0.0]))


def test_only_what_changes_is_written(stage, writer):
    looks = [base(), with_table(texture="oak"), base()]
    looks[2] = looks[0]
    writer.write(looks)
    for values in writer.fields.values():
        values[0] = 0
    writer.write(looks)
    assert not writer.fields["mat_rgba"][0].any(), "nothing changed, and nothing was written"
    writer.write([looks[1]])
    assert writer.fields["mat_rgba"][0].any()


def test_looks_that_are_equal_and_not_the_same_are_worn_alike(stage, writer):
    writer.write([with_table(rgb=(0.4, 0.5, 0.6)), with_table(rgb=(0.4, 0.5, 0.6))])
    for name, values in writer.fields.items():
        assert torch.equal(values[0], values[1]), name


def test_a_surface_without_a_material_is_plain(stage, writer):
    look = dataclasses.replace(base(), materials={"wall": SurfaceMaterial(rgb=(0.0, 0.0, 1.0))})
    writer.write([look])
    wall = material(stage, "wall")
    assert writer.fields["mat_rgba"][0, wall, :3].tolist() == [0.0, 0.0, 1.0]

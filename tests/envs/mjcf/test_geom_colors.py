"""Colours and images of geoms, by MuJoCo's rules."""

import mujoco
import numpy as np

from envs.mjcf.geom_colors import image_of, rgba_of, surfaces_of, texture_id
from envs.mjcf.model import build_model
from envs.tasks.pick_cube import PickCube

XML = """<mujoco><asset>
  <texture name="squares" type="2d" builtin="checker" rgb1="1 0 0" rgb2="0 0 1" width="4" height="2"/>
  <material name="red" rgba="1 0 0 1"/><material name="board" texture="squares"/></asset><worldbody>
  <geom size=".1" material="red"/><geom size=".1" material="red" rgba="0 1 0 1"/>
  <geom size=".1"/><geom size=".1" material="board"/></worldbody></mujoco>"""


def test_a_geom_without_a_colour_takes_its_materials_and_the_model_stays_as_it_is():
    model = mujoco.MjModel.from_xml_string(XML)
    before = model.geom_rgba.copy()
    colours = rgba_of(model, np.arange(3)).tolist()
    assert colours == [[1, 0, 0, 1], [0, 1, 0, 1], [0.5, 0.5, 0.5, 1]]
    np.testing.assert_array_equal(model.geom_rgba, before)


def test_the_image_of_a_material_is_rgb_and_a_copy():
    model = mujoco.MjModel.from_xml_string(XML)
    assert [texture_id(model, geom) for geom in range(4)] == [-1, -1, -1, 0]
    image = image_of(model, 0)
    assert image.shape == (2, 4, 3)
    assert {tuple(pixel) for pixel in image.reshape(-1, 3).tolist()} == {(255, 0, 0), (0, 0, 255)}
    assert not np.shares_memory(image, model.tex_data)


def test_surfaces_are_found_by_their_materials():
    model = build_model(PickCube().scenario)
    found = surfaces_of(model)
    assert set(found.values()) == {"table", "wall", "ground"}
    assert found[model.geom("ground").id] == "ground"

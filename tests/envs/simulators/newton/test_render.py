"""Newton's images beyond the contract of renderers."""

import dataclasses
from itertools import pairwise

import mujoco
import numpy as np
import pytest

from envs.core.extras import install_command

pytest.importorskip("newton", reason=f"Newton is not installed: {install_command('newton')}")

import envs
from envs.core.errors import SimulatorError
from envs.mjcf.model import build_model
from envs.mjcf.objects import SCENE_GROUP
from envs.scenario import LightCfg
from envs.simulators import RENDERERS
from envs.simulators.newton.surfaces import brightened
from envs.tasks.pick_cube import PickCube


def image(renderer, level):
    env = envs.make_vec(
        "PickCube", 1, level=level, split="train", renderer=renderer, image_size=64, num_threads=1
    )
    try:
        env.reset_envs([0], env.split_indices[:1])
        return env.handler.render(("front",))["front"]["rgb"][0].astype(float)
    finally:
        env.close()


@pytest.mark.parametrize("level", range(4))
def test_a_draw_of_every_level_looks_as_the_default_renderer_shows_it(level):
    """Alike, but for shadows that keep three tenths of the light, highlights, and smoothing."""
    ours, theirs = image("newton", level), image("warp", level)
    apart = np.abs(ours - theirs).mean(axis=-1)
    assert np.median(apart) < 16
    assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.85


def test_levels_differ():
    images = [image("newton", level) for level in range(4)]
    for easier, harder in pairwise(images):
        assert np.abs(easier - harder).mean() > 3


def test_light_is_brightened_as_a_screen_shows_it():
    shown = brightened(np.array([0.0, 0.0031308, 0.5, 1.0, 2.0]))
    np.testing.assert_allclose(shown, [0.0, 0.04045, 0.7354, 1.0, 1.0], atol=1e-4)


def test_a_shape_that_newton_cannot_trace_is_refused_by_name():
    scenario = PickCube().scenario
    model = build_model(scenario)
    drawn = np.flatnonzero((model.geom_group == SCENE_GROUP) & (model.geom_rgba[:, 3] > 0))
    model.geom_type[drawn[0]] = int(mujoco.mjtGeom.mjGEOM_HFIELD)
    with pytest.raises(
        SimulatorError, match=r"renderer=newton cannot render the geom '.*' \(mjGEOM_HFIELD\)"
    ):
        RENDERERS.get("newton")(model, scenario)


def test_two_distant_lights_both_shine():
    task = PickCube()
    first = LightCfg(intensity=0.4, direction=(0.0, 0.0, -1.0))
    second = dataclasses.replace(first, direction=(0.3, 0.0, -1.0))
    means = []
    for lights in ((first,), (first, second)):
        looks = dataclasses.replace(task.scenario.appearance, lights=lights)
        env = envs.make_vec("PickCube", 1, split="train", renderer="newton", image_size=32, num_threads=1)
        try:
            env.reset_envs([0], env.split_indices[:1])
            env.handler.set_appearance(looks, 0)
            means.append(env.handler.render(("front",))["front"]["rgb"].mean())
        finally:
            env.close()
    assert means[1] > 1.3 * means[0]

"""The comparison with bare mujoco_warp, of a few worlds on a CPU: it runs, and compares like with like."""

import pytest

from roboverse_learn.speed import BENCHMARKS
from roboverse_learn.speed.mujoco_warp import CPU, GPU, Scale, measure_physics, measure_render

TINY = Scale(physics_worlds=2, control_steps=1, render_worlds=2, pictures=1, turns=1)


def test_it_is_registered_and_a_gpu_gets_what_was_promised():
    assert BENCHMARKS.entry("mujoco_warp").target == "roboverse_learn.speed.mujoco_warp"
    assert GPU.physics_worlds == 8192
    assert CPU.physics_worlds < 64


def test_physics_ends_where_bare_physics_ends():
    measurement = measure_physics(TINY, "cpu")
    assert measurement.ours_s > 0 < measurement.baseline_s
    assert str(measurement).startswith("physics of PickCube, 2 worlds on cpu, bare mujoco_warp / ours")


def test_pictures_are_timed_at_their_size():
    measurement = measure_render(TINY, 16, "cpu")
    assert measurement.ratio == pytest.approx(measurement.baseline_s / measurement.ours_s)
    assert "RGB 16×16, 2 worlds on cpu" in measurement.name


def test_pictures_of_the_robots_own_meshes_are_another_reference():
    measurement = measure_render(TINY, 16, "cpu", simplified=False)
    assert measurement.ours_s > 0 < measurement.baseline_s
    assert measurement.name.endswith("bare mujoco_warp.render of unsimplified meshes / ours")
    assert "goal ≥ 2.00" in measurement.goal

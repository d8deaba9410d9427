"""Lights stay in the stated ranges, and their colours are those of a black body."""

import math

import numpy as np
import pytest

from envs.core.errors import ConfigError
from envs.randomization.lights import (
    LightingCfg,
    build_lights,
    draw_lights,
    draw_reflection,
    planckian_xy,
    temperature_to_rgb,
)


# Planckian locus in CIE 1931, from Wyszecki & Stiles, Color Science (1982), as tabulated for the
# 2 degree observer; D65's neighbour at 6500 K is (0.3135, 0.3237).
@pytest.mark.parametrize(
    ("temperature_k", "xy"),
    [
        (2000, (0.5267, 0.4133)),
        (4000, (0.3805, 0.3768)),
        (5000, (0.3451, 0.3516)),
        (6500, (0.3135, 0.3237)),
        (8000, (0.2952, 0.3048)),
    ],
)
def test_chromaticity_is_that_of_a_black_body(temperature_k, xy):
    assert planckian_xy(temperature_k) == pytest.approx(xy, abs=5e-4)


def test_warm_light_is_red_and_cold_light_blue():
    warm, neutral, cold = (temperature_to_rgb(t) for t in (4000, 6500, 8000))
    assert warm == pytest.approx((1.0, 0.653, 0.377), abs=2e-3)
    assert neutral == pytest.approx((1.0, 0.944, 0.993), abs=2e-3)
    assert cold == pytest.approx((0.766, 0.802, 1.0), abs=2e-3)


def test_colours_change_steadily_with_temperature():
    ratios = [(rgb := temperature_to_rgb(t))[2] / rgb[0] for t in range(4000, 8001, 50)]
    assert np.all(np.diff(ratios) > 0)


def test_a_temperature_out_of_range_is_an_error():
    with pytest.raises(ConfigError, match="A colour temperature is 1667 to 25000 K, given 900"):
        temperature_to_rgb(900)


def draws(count=300, cfg=None):
    cfg = cfg or LightingCfg()
    return [build_lights(draw_lights(np.random.default_rng(seed), cfg), cfg) for seed in range(count)]


def test_there_is_one_distant_light_and_a_grid_of_lamps_inside_the_room():
    for lights in draws(20):
        assert [light.kind for light in lights] == ["distant"] + ["area"] * 6
        places = {light.pos for light in lights[1:]}
        assert {x for x, _, _ in places} == {-1.0, 1.0}
        assert {y for _, y, _ in places} == {-2.0, 0.0, 2.0}
        assert all(0.05 <= lamp.radius_m <= 0.1 and 0.5 <= lamp.length_m <= 2.0 for lamp in lights[1:])
        assert len({light.color for light in lights}) == 1


def test_light_array_has_the_configured_shape():
    lights = draws(1, LightingCfg(array_shape=(3, 4)))[0]
    assert len(lights) == 13
    assert sum(np.array([light.pos[:2] for light in lights[1:]])).tolist() == pytest.approx([0, 0])


def test_the_distant_light_shines_down_from_all_polar_angles():
    angles = []
    for distant, *_ in draws():
        assert math.dist(distant.direction, (0, 0, 0)) == pytest.approx(1)
        angles.append(math.degrees(math.acos(-distant.direction[2])))
    assert min(angles) < 5 and 55 < max(angles) <= 60


def irradiance_on_table(lights):
    """What a white, chalky, horizontal surface at the origin reflects, as LightCfg defines it."""
    total = 0.0
    for light in lights:
        if light.kind == "distant":
            cosine = -light.direction[2]
        else:
            cosine = light.pos[2] / math.dist(light.pos, (0, 0, 0))
        total += light.intensity * max(light.color) * cosine
    return total


def test_a_white_table_is_neither_black_nor_burnt_out():
    totals = [irradiance_on_table(lights) for lights in draws()]
    assert 0.3 < min(totals) < 0.5
    assert 0.9 < max(totals) < 1.15


def test_reflection_covers_its_range():
    drawn = [draw_reflection(np.random.default_rng(seed)) for seed in range(300)]
    values = np.array([[draw.roughness, draw.specular, draw.metallic] for draw in drawn])
    assert values.min() >= 0 and values.max() < 1
    assert values.min(axis=0).max() < 0.05 and values.max(axis=0).min() > 0.95


def test_a_range_upside_down_is_an_error():
    with pytest.raises(ConfigError, match=r"radius_m is a range 0 <= low <= high, given \(2, 1\)"):
        LightingCfg(radius_m=(2, 1))
    with pytest.raises(ConfigError, match=r"array_shape is two positive counts, given \(0, 3\)"):
        LightingCfg(array_shape=(0, 3))

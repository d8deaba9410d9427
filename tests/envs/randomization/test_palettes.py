"""Colours and how tones become them."""

import numpy as np
import pytest

from envs.randomization.procedural import palettes
from envs.randomization.procedural.noise import Stream, relief, sine, smoothstep


def test_a_code_is_red_green_blue():
    assert palettes.color("ff8000").tolist() == [255, 128, 0]


def test_every_palette_holds_valid_codes():
    groups = [*palettes.WOODS.values(), *palettes.MARBLES.values(), *palettes.GRANITES.values()]
    groups += [*palettes.BRICKS.values(), palettes.STONES, palettes.CONCRETES, palettes.PAINTS]
    groups += [palettes.TEXTILES, palettes.CERAMICS, palettes.METALS, palettes.LEATHERS, palettes.GROUTS]
    for code in (code for group in groups for code in group):
        assert len(code) == 6
        assert palettes.color(code).min() >= 0 and palettes.color(code).max() <= 255


def test_a_tint_stays_near_its_colour():
    for key in range(50):
        change = palettes.tinted(Stream("tint", key), "808080", amount=12) - palettes.color("808080")
        assert np.abs(change).max() <= 16
        assert np.ptp(change) <= 8


def test_a_ramp_passes_through_its_colours():
    ramp = palettes.blend([palettes.color(code) for code in ("000000", "ff0000", "ffffff")], steps=513)
    assert ramp[[0, 256, 512]].tolist() == [[0, 0, 0], [255, 0, 0], [255, 255, 255]]
    assert ramp[128] == pytest.approx([127.5, 0, 0])


def test_tones_outside_the_ramp_take_its_ends():
    ramp = palettes.blend([palettes.color("000000"), palettes.color("ffffff")])
    image = palettes.paint(ramp, np.array([[-3.0, 0.0], [1.0, 9.0]], dtype=np.float32))
    assert image[:, :, 0].tolist() == [[0, 0], [255, 255]]


def test_a_mask_lays_one_colour_over_another():
    below = np.zeros((1, 3, 3), dtype=np.float32)
    mask = np.array([[0.0, 0.5, 1.0]], dtype=np.float32)
    assert palettes.mix(below, palettes.color("c86432"), mask)[0, :, 0].tolist() == [0, 100, 200]


def test_sine_and_smoothstep_have_their_known_values():
    assert sine(np.array([0.0, 0.25, 0.5, 1.75], dtype=np.float32)) == pytest.approx([0, 1, 0, -1], abs=1e-3)
    x = np.array([-1.0, 2.0, 3.0, 4.0, 9.0], dtype=np.float32)
    assert smoothstep(x, 2.0, 4.0).tolist() == [0, 0, 0.5, 1, 1]


def test_flat_ground_is_not_shaded_and_a_slope_towards_the_light_is_brighter():
    assert np.all(relief(np.ones((8, 8), dtype=np.float32), 0.5) == 1)
    step = np.zeros((256, 256), dtype=np.float32)
    step[100:, :] = 1
    shading = relief(step, 0.1)
    assert shading[100, 5] > 1 > shading[0, 5]

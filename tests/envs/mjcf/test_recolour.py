"""Another colour in place of an image's most frequent one."""

import colorsys

import numpy as np
import pytest
from PIL import Image

from envs.mjcf.recolour import COLOUR_HUES_DEG, most_frequent_hue_deg, recoloured

RED, GREEN, WHITE, BLACK = (200, 0, 0), (0, 90, 0), (255, 255, 255), (0, 0, 0)


def _image(*colours):
    return Image.fromarray(np.array([colours], np.uint8))


@pytest.mark.parametrize(
    ("colour", "expected"),
    [("red", (200, 0, 0)), ("yellow", (200, 167, 0)), ("green", (0, 200, 17)), ("blue", (0, 67, 200))],
)
def test_the_most_frequent_colour_gets_the_hue_and_keeps_its_brightness(colour, expected):
    pixels = np.asarray(recoloured(_image(RED, RED, RED, GREEN), colour), int)[0]
    np.testing.assert_allclose(pixels[:3], [expected] * 3, atol=2)
    np.testing.assert_allclose(pixels[3], GREEN, atol=2)


def test_white_grey_and_black_stay():
    pale = (100, 100, 110)  # saturation 0.09
    pixels = np.asarray(recoloured(_image(RED, WHITE, BLACK, pale), "blue"), int)[0]
    np.testing.assert_allclose(pixels[1:], [WHITE, BLACK, pale], atol=2)


def test_pale_colours_get_more_of_it():
    pixel = np.asarray(recoloured(_image((200, 100, 100)), "red"), int)[0, 0]
    np.testing.assert_allclose(pixel, (200, 50, 50), atol=2)  # a saturation of 0.5 becomes 0.75


def test_shades_of_a_colour_stay_different():
    pixels = np.asarray(recoloured(_image(*[RED] * 3, (200, 100, 0)), "blue"), float)[0] / 255.0
    hues = [360.0 * colorsys.rgb_to_hsv(*pixel)[0] for pixel in pixels]
    assert hues[3] - hues[0] == pytest.approx(0.2 * 30, abs=0.5)  # orange is 30 degrees from red


def test_hues_round_zero_count_together():
    hue, weight = np.array([355.0, 4.0, 120.0]), np.array([1.0, 1.0, 1.5])
    assert abs((most_frequent_hue_deg(hue, weight) + 180) % 360 - 180) <= 40


def test_every_colour_has_a_hue_of_its_own():
    hues = sorted(COLOUR_HUES_DEG.values())
    assert min(np.diff([*hues, hues[0] + 360.0])) >= 50.0

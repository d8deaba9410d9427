"""Images in which the colour that most of their surface has is another one.

A print keeps its letters, its white and its other colours: a red carton of milk with a green meadow becomes a
blue carton with a green meadow.
"""

import numpy as np
from PIL import Image

COLOUR_HUES_DEG = {"red": 0.0, "yellow": 50.0, "green": 125.0, "blue": 220.0, "purple": 285.0}
"""Hue of each colour that objects can have: 0 is red, 120 green, 240 blue."""

SPAN_DEG = 40.0
"""Hues that differ from the most frequent one by up to this count as the same colour."""

LEAST_SATURATION = 0.15
"""Pixels below this are white, grey or black, and stay so."""

_SHADES = 0.2  # of a hue's difference from the most frequent one: a print keeps shades, and its new colour
_BINS = 72


def recoloured(image: Image.Image, colour: str) -> Image.Image:
    """Returns an RGB image whose most frequent colour is another one.

    Saturation is raised, so that pale colours can be told apart; brightness stays.

    Args:
        image: The image.
        colour: One of :data:`COLOUR_HUES_DEG`.
    """
    import cv2

    pixels = np.asarray(image.convert("RGB"), np.float32) / 255.0
    hue, saturation, value = np.moveaxis(cv2.cvtColor(pixels, cv2.COLOR_RGB2HSV), -1, 0)  # degrees, 0 to 1
    coloured = saturation >= LEAST_SATURATION
    usual = most_frequent_hue_deg(hue, np.where(coloured, saturation * value, 0.0))
    away = (hue - usual + 180.0) % 360.0 - 180.0
    meant = coloured & (np.abs(away) <= SPAN_DEG)
    hue = np.where(meant, (COLOUR_HUES_DEG[colour] + _SHADES * away) % 360.0, hue)
    saturation = np.where(meant, 1.0 - (1.0 - saturation) ** 2, saturation)
    out = cv2.cvtColor(np.stack([hue, saturation, value], axis=-1).astype(np.float32), cv2.COLOR_HSV2RGB)
    return Image.fromarray(np.rint(255.0 * out).astype(np.uint8))


def most_frequent_hue_deg(hue_deg: np.ndarray, weight: np.ndarray) -> float:
    """Returns the hue round which most weight lies, within :data:`SPAN_DEG` of it to either side."""
    counts = np.histogram(hue_deg % 360.0, bins=_BINS, range=(0.0, 360.0), weights=weight)[0]
    reach = int(SPAN_DEG * _BINS / 360.0)
    near = sum(np.roll(counts, turn) for turn in range(-reach, reach + 1))
    return (float(np.argmax(near)) + 0.5) * 360.0 / _BINS

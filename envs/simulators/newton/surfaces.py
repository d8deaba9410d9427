"""Images of table, walls and ground in Newton's camera sensor, changed at every episode."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp
from newton.sensors import SensorCamera

from envs.scenario import SURFACES

MAX_KEPT = 64
"""Largest number of cached images; then the cache is cleared."""


class SurfaceImages:
    """One place per surface in the sensor's table of images.

    Newton reads images when a sensor is made, and making one compiles its kernel again. So the places are
    added to the table that the kernel is given.

    Args:
        sensor: The sensor.
        surfaces: Surface of each shape, or None.
    """

    def __init__(self, sensor: SensorCamera, surfaces: Sequence[str | None]) -> None:
        self._context: Any = sensor._render_context
        self._entry = self._context._texture_data.dtype
        self._table: list[Any] = [*self._context._texture_data_source]
        self._first = len(self._table)
        ids = self._context._shape_texture_ids.numpy().copy()
        for shape, surface in enumerate(surfaces):
            if surface is not None:
                ids[shape] = self._first + SURFACES.index(surface)
        self._context._shape_texture_ids = wp.array(ids, dtype=wp.int32, device="cpu")
        self._table += [self._entry() for _ in SURFACES]
        self._kept: dict[str | None, Any] = {}
        self._shown: dict[str, tuple[str | None, float]] = {}
        self._changed = False

    def show(self, surface: str, name: str | None, metres: float, read: Callable[[], np.ndarray]) -> None:
        """Gives a surface an image.

        Args:
            surface: Which.
            name: Name of the image; None for white.
            metres: Length of its sides.
            read: Reads it, (S, S, 3) uint8.
        """
        if self._shown.get(surface) == (name, metres):
            return
        if name not in self._kept:
            if len(self._kept) >= MAX_KEPT:
                self._kept.clear()
            self._kept[name] = _texture(read())
        data = self._entry()
        data.texture, data.repeat = self._kept[name], wp.vec2f(1.0 / metres, 1.0 / metres)
        self._table[self._first + SURFACES.index(surface)] = data
        self._shown[surface] = (name, metres)
        self._changed = True

    def upload(self) -> None:
        """Hands the table to the sensor, if it has changed."""
        if self._changed:
            self._context._texture_data = wp.array(self._table, dtype=self._entry, device="cpu")
            self._changed = False

    def close(self) -> None:
        """Removes all images."""
        self._kept, self._table, self._context = {}, [], None


def brightened(light: np.ndarray) -> np.ndarray:
    """Returns what a screen shows as this share of light, by the curve of sRGB (IEC 61966-2-1)."""
    light = np.clip(light, 0.0, 1.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)


def _texture(image: np.ndarray) -> wp.Texture2D:
    pixels = np.full((*image.shape[:2], 4), 255, np.uint8)
    pixels[..., :3] = np.rint(255.0 * brightened(image / 255.0))
    return wp.Texture2D(
        pixels,
        filter_mode=wp.TextureFilterMode.LINEAR,
        address_mode=wp.TextureAddressMode.WRAP,
        normalized_coords=True,
        dtype=wp.uint8,
        num_channels=4,
        device="cpu",
    )

"""Ranges of the lighting channel: a distant light and an array of cylinder lamps.

Intensities are relative: a light of intensity 1 that shines straight on a white chalky surface lights it
to 1.0. The ranges keep the sum of all lights on the table between about 0.3 and 1.1, so that an image
is neither black nor burnt out with or without a renderer's ambient light.
"""

import math
from dataclasses import dataclass

from envs.core.errors import ConfigError
from envs.core.ranges import check_ranges

Range = tuple[float, float]

MAX_LAMPS = 99
"""With the distant light, as many lights as MuJoCo's OpenGL renderer supports."""

TEMPERATURES_K = (1667.0, 25000.0)
"""Range where the colour of a black body is defined; see :func:`envs.randomization.lights.planckian_xy`."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LightingCfg:
    """Ranges of the lighting channel; RoboVerse's level 3 where it gives a range.

    Attributes:
        distant_intensity: Intensity of the distant light.
        distant_polar_rad: Angle between the distant light and straight down.
        array_shape: Lamps along world x and along world y, 99 in all at most.
        array_spacing_m: Distance between neighbouring lamps.
        array_height_m: Height of the lamps over the table.
        array_intensity: Intensity of all lamps together.
        radius_m: Radius of a lamp.
        length_m: Length of a lamp.
        temperature_k: Colour temperature of all lights, K, 1667 to 25000.
        cast_shadow: Whether the distant light casts shadows; the lamps, being soft, never do.
    """

    distant_intensity: Range = (0.3, 0.6)
    distant_polar_rad: Range = (0.0, math.pi / 3)
    array_shape: tuple[int, int] = (2, 3)
    array_spacing_m: float = 2.0
    array_height_m: float = 3.2
    array_intensity: Range = (0.2, 0.6)
    radius_m: Range = (0.05, 0.1)
    length_m: Range = (0.5, 2.0)
    temperature_k: Range = (4000.0, 8000.0)
    cast_shadow: bool = True

    def __post_init__(self) -> None:
        ranges = {name: getattr(self, name) for name in _RANGES}
        for name, (low, high) in ranges.items():
            if not 0 <= low <= high:
                raise ConfigError(f"LightingCfg.{name} is a range 0 <= low <= high, given ({low}, {high}).")
        coldest, hottest = TEMPERATURES_K
        low, high = self.temperature_k
        if not coldest <= low <= high <= hottest:
            raise ConfigError(
                f"temperature_k must be within {coldest:g} to {hottest:g} K, given ({low}, {high})."
            )
        if min(self.array_shape) < 1:
            raise ConfigError(f"LightingCfg.array_shape is two positive counts, given {self.array_shape}.")
        if self.num_lamps > MAX_LAMPS:
            raise ConfigError(
                f"LightingCfg.array_shape has at most {MAX_LAMPS} lamps in all, given {self.array_shape}."
            )
        check_ranges(self, "LightingCfg.", above_0=("array_spacing_m", "array_height_m"))

    @property
    def num_lamps(self) -> int:
        """Lamps of the array."""
        return self.array_shape[0] * self.array_shape[1]


_RANGES = (
    "distant_intensity",
    "distant_polar_rad",
    "array_intensity",
    "radius_m",
    "length_m",
    "temperature_k",
)

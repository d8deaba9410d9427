"""Materials that are computed from their names.

A name is a family and a number, ``"wood-017"``; :func:`texture` turns it into a seamless image, the
same bytes on every machine. Nothing is stored.
"""

import functools
import importlib
from dataclasses import dataclass

import numpy as np

from envs.core.errors import ConfigError, UnknownNameError, unknown_name
from envs.randomization.procedural.noise import Stream

VERSION = 1
"""Changes whenever any texture changes; the frozen splits name it."""

NATIVE_SIZE = 256
"""Smaller powers of two are averages of this size, so a material looks the same at each."""


@dataclass(frozen=True, slots=True)
class Family:
    """A kind of material.

    Attributes:
        name: First part of its materials' names.
        module: Module of this package that generates it, by a function named like the family.
        size_m: Range of the side of the square that one copy of its texture covers.
        counts: How many materials it gives each surface: table, wall, ground.
    """

    name: str
    module: str
    size_m: tuple[float, float]
    counts: tuple[int, int, int]


FAMILIES = {
    family.name: family
    for family in (
        Family("wood", "wood", (0.7, 1.2), (62, 0, 0)),
        Family("butcher", "wood", (0.6, 1.0), (16, 0, 0)),
        Family("end-grain", "wood", (0.5, 0.8), (10, 0, 0)),
        Family("inlay", "wood", (0.6, 1.2), (10, 0, 0)),
        Family("bamboo", "wood", (0.6, 1.0), (12, 0, 0)),
        Family("chipboard", "wood", (0.6, 1.2), (8, 0, 4)),
        Family("parquet", "wood", (0.8, 1.4), (0, 0, 22)),
        Family("planks", "wood", (1.0, 1.8), (0, 0, 36)),
        Family("panel", "wood", (1.0, 1.8), (0, 16, 0)),
        Family("marble", "stone", (0.7, 1.2), (40, 6, 8)),
        Family("granite", "stone", (0.6, 1.0), (30, 0, 4)),
        Family("terrazzo", "stone", (0.6, 1.2), (20, 0, 8)),
        Family("slate", "stone", (0.7, 1.2), (10, 0, 4)),
        Family("travertine", "stone", (0.7, 1.2), (8, 6, 4)),
        Family("concrete", "stone", (1.0, 2.0), (8, 14, 10)),
        Family("plaster", "stone", (1.0, 2.0), (0, 22, 0)),
        Family("asphalt", "stone", (0.8, 1.4), (0, 0, 6)),
        Family("bricks", "masonry", (0.9, 1.4), (0, 26, 0)),
        Family("rubble", "masonry", (1.2, 2.0), (0, 8, 0)),
        Family("tiles", "masonry", (0.8, 1.4), (0, 14, 10)),
        Family("hexagons", "masonry", (0.8, 1.4), (0, 4, 4)),
        Family("encaustic", "masonry", (0.6, 1.0), (0, 0, 6)),
        Family("diamonds", "masonry", (0.8, 1.4), (0, 2, 2)),
        Family("paving", "masonry", (1.2, 2.0), (0, 0, 8)),
        Family("fabric", "textile", (0.6, 0.9), (36, 0, 0)),
        Family("leather", "textile", (0.6, 0.9), (8, 0, 0)),
        Family("linoleum", "textile", (0.8, 1.4), (4, 0, 4)),
        Family("carpet", "textile", (0.8, 1.4), (0, 0, 8)),
        Family("wallpaper", "textile", (0.9, 1.6), (0, 20, 0)),
        Family("painted", "coating", (1.0, 2.0), (0, 12, 0)),
        Family("laminate", "coating", (0.6, 1.2), (10, 0, 0)),
        Family("metal", "coating", (0.7, 1.2), (6, 0, 0)),
        Family("cork", "coating", (0.6, 1.0), (2, 0, 0)),
        Family("rubber", "coating", (0.8, 1.2), (0, 0, 2)),
    )
}
"""Every family. A family's numbers run on from table to wall to ground, so surfaces share no material."""

_FORM = "A material is a family and a number: 'wood-017'."


def surface_names(surface: int) -> tuple[str, ...]:
    """Returns the materials of surface 0 (table), 1 (wall) or 2 (ground)."""
    names = []
    for family in FAMILIES.values():
        start = sum(family.counts[:surface])
        names += [f"{family.name}-{start + i:03d}" for i in range(family.counts[surface])]
    return tuple(names)


def parse(name: str) -> tuple[Family, int]:
    """Splits a material's name into its family and number.

    Raises:
        UnknownNameError: if the family does not exist or the number is not one.
    """
    family, _, number = name.rpartition("-")
    if name in FAMILIES or (family in FAMILIES and not number.isdecimal()):
        raise UnknownNameError(f"Material '{name}' has no number. {_FORM}")
    if family not in FAMILIES:
        raise unknown_name("material family", family or name, FAMILIES, _FORM)
    return FAMILIES[family], int(number)


@functools.lru_cache(maxsize=128)
def texture(name: str, size: int = NATIVE_SIZE) -> np.ndarray:
    """Draws a material.

    Args:
        name: Its name, such as ``"wood-017"``.
        size: Pixels along a side, 16 to 2048.

    Returns:
        Read-only (size, size, 3) uint8 sRGB; copies laid side by side show no seam.

    Raises:
        UnknownNameError: if there is no such material.
        ConfigError: if the size is out of range.
    """
    family, number = parse(name)
    if not 16 <= size <= 2048:
        raise ConfigError(f"A texture's size is 16 to 2048 pixels, given {size}.")
    native = NATIVE_SIZE if size < NATIVE_SIZE and NATIVE_SIZE % size == 0 else size
    module = importlib.import_module(f"{__name__}.{family.module}")
    draw = getattr(module, family.name.replace("-", "_"))
    rgb = draw(Stream("texture", VERSION, family.name, number), native)
    pixels = (np.clip(rgb, 0.0, 255.0) + np.float32(0.5)).astype(np.uint8)
    if native != size:
        pixels = _shrink(pixels, native // size)
    pixels.setflags(write=False)
    return pixels


def _shrink(pixels: np.ndarray, factor: int) -> np.ndarray:
    """Averages squares of ``factor`` by ``factor`` pixels, in integers."""
    side = pixels.shape[0] // factor
    total = pixels.reshape(side, factor, side, factor, 3).astype(np.uint32).sum(axis=(1, 3))
    return ((total + factor * factor // 2) // (factor * factor)).astype(np.uint8)

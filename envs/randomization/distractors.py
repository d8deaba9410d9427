"""Objects that have no part in a task: a catalogue made from primitives.

A distractor is named, never stored: ``"bottle-2"`` is the same shape and colours on every machine. Its origin
is in the middle of its footprint, on what it stands on. None is red or green, and none is a cube, a peg or a
nut, so the instruction of a task still names one thing. All are lower than 12 cm: an arm that starts higher
clears them.
"""

import math
from dataclasses import dataclass
from functools import cache

from envs.randomization.procedural.noise import Stream
from envs.scenario import GeomCfg, ObjectCfg, Rgba

KINDS = ("can", "bottle", "carton", "ball", "bowl", "mug", "book", "candle", "stapler", "hourglass")

VARIANTS = 3
"""Distractors of each kind, which differ in size and colours."""

CATALOGUE = tuple(f"{kind}-{variant}" for kind in KINDS for variant in range(VARIANTS))
"""All names, in an order that stays: 30."""

HEIGHT_M = 0.12
"""No distractor is higher."""

_COLOURS: tuple[Rgba, ...] = (
    (0.10, 0.20, 0.60, 1.0),
    (0.85, 0.65, 0.10, 1.0),
    (0.45, 0.15, 0.55, 1.0),
    (0.85, 0.45, 0.10, 1.0),
    (0.90, 0.88, 0.82, 1.0),
    (0.08, 0.45, 0.55, 1.0),
    (0.32, 0.20, 0.12, 1.0),
    (0.12, 0.12, 0.14, 1.0),
    (0.90, 0.55, 0.65, 1.0),
)


@dataclass(frozen=True, slots=True)
class Distractor:
    """One object of the catalogue.

    Attributes:
        name: Its name.
        geoms: What it is made of.
        radius_m: Radius of its footprint.
    """

    name: str
    geoms: tuple[GeomCfg, ...]
    radius_m: float

    def as_object(self) -> ObjectCfg:
        """Returns it as an object that stays where it is put: it collides, and nothing moves it."""
        return ObjectCfg(name=object_name(self.name), geoms=self.geoms, kind="fixed")


def object_name(name: str) -> str:
    """Returns the name in a scene, such as ``"distractor_bottle_2"``."""
    return f"distractor_{name.replace('-', '_')}"


@cache
def distractor(name: str) -> Distractor:
    """Returns a distractor of :data:`CATALOGUE`."""
    kind, _, _ = name.rpartition("-")
    stream = Stream("distractor", name)

    def between(low: float, high: float) -> float:
        return round(low + (high - low) * stream.integer(0, 1000) / 1000, 4)

    first = stream.integer(0, len(_COLOURS) - 1)
    second = (first + 1 + stream.integer(0, len(_COLOURS) - 2)) % len(_COLOURS)
    geoms = _SHAPES[kind](between, _COLOURS[first], _COLOURS[second])
    return Distractor(name, geoms, round(max(_reach(geom) for geom in geoms), 4))


def _box(half: tuple[float, float, float], z: float, rgba: Rgba, x: float = 0.0) -> GeomCfg:
    return GeomCfg(shape="box", size=half, pos=(x, 0.0, z), rgba=rgba)


def _cylinder(radius: float, half: float, z: float, rgba: Rgba) -> GeomCfg:
    return GeomCfg(shape="cylinder", size=(radius, half), pos=(0.0, 0.0, z), rgba=rgba)


def _can(between, one: Rgba, other: Rgba) -> tuple[GeomCfg, ...]:
    radius, half = between(0.028, 0.034), between(0.03, 0.05)
    lid = _cylinder(0.85 * radius, 0.003, 2 * half + 0.003, other)
    return _cylinder(radius, half, half, one), lid


def _bottle(between, one: Rgba, other: Rgba) -> tuple[GeomCfg, ...]:
    radius, half = between(0.022, 0.03), between(0.03, 0.038)
    neck = between(0.012, 0.018)
    return _cylinder(radius, half, half, one), _cylinder(0.45 * radius, neck, 2 * half + neck, other)


def _carton(between, one: Rgba, other: Rgba) -> tuple[GeomCfg, ...]:
    half = (between(0.02, 0.03), between(0.035, 0.05), between(0.045, 0.055))
    band = (half[0] + 0.001, half[1] + 0.001, 0.2 * half[2])
    return _box(half, half[2], one), _box(band, 1.2 * half[2], other)


def _ball(between, one: Rgba, other: Rgba) -> tuple[GeomCfg, ...]:
    radius = between(0.028, 0.04)
    return (
        GeomCfg(shape="sphere", size=(radius,), pos=(0.0, 0.0, radius), rgba=one),
        _cylinder(0.6 * radius, 0.002, 0.002, other),
    )


def _bowl(between, one: Rgba, other: Rgba) -> tuple[GeomCfg, ...]:
    radius, half = between(0.045, 0.06), between(0.015, 0.022)
    foot = _cylinder(0.6 * radius, 0.004, 0.004, other)
    return foot, _cylinder(radius, half, 0.008 + half, one)


def _mug(between, one: Rgba, other: Rgba) -> tuple[GeomCfg, ...]:
    radius, half = between(0.028, 0.036), between(0.035, 0.045)
    handle = _box((0.011, 0.005, 0.6 * half), half, other, radius + 0.009)
    return _cylinder(radius, half, half, one), handle


def _book(between, one: Rgba, other: Rgba) -> tuple[GeomCfg, ...]:
    half = (between(0.04, 0.05), between(0.055, 0.07), between(0.008, 0.013))
    title = (0.5 * half[0], 0.6 * half[1], 0.0005)
    return _box(half, half[2], one), _box(title, 2 * half[2] + 0.0005, other)


def _candle(between, one: Rgba, other: Rgba) -> tuple[GeomCfg, ...]:
    plate, radius, half = between(0.032, 0.04), between(0.012, 0.018), between(0.03, 0.048)
    return _cylinder(plate, 0.004, 0.004, other), _cylinder(radius, half, 0.008 + half, one)


def _stapler(between, one: Rgba, other: Rgba) -> tuple[GeomCfg, ...]:
    length, width = between(0.05, 0.065), between(0.014, 0.018)
    base = _box((length, width, 0.006), 0.006, other)
    return base, _box((0.9 * length, width, between(0.012, 0.016)), 0.03, one, -0.1 * length)


def _hourglass(between, one: Rgba, other: Rgba) -> tuple[GeomCfg, ...]:
    radius, half = between(0.022, 0.028), between(0.016, 0.022)
    waist = _cylinder(0.35 * radius, 0.006, 2 * half + 0.006, other)
    upper = _cylinder(radius, half, 3 * half + 0.012, one)
    return _cylinder(radius, half, half, one), waist, upper


_SHAPES = {
    "can": _can,
    "bottle": _bottle,
    "carton": _carton,
    "ball": _ball,
    "bowl": _bowl,
    "mug": _mug,
    "book": _book,
    "candle": _candle,
    "stapler": _stapler,
    "hourglass": _hourglass,
}


def _reach(geom: GeomCfg) -> float:
    """Returns how far a geom reaches from the distractor's middle, seen from above."""
    x, y, _ = geom.pos
    flat = math.hypot(*geom.size[:2]) if geom.shape == "box" else geom.size[0]
    return math.hypot(x, y) + flat

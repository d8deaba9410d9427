"""Furniture made from primitives, and layouts of it.

A piece is named, never stored: ``"bookcase-07"`` is the same shape and colours on every machine. So is a
layout, ``"layout-12"``: the kind of furniture at each place of the room, or nothing. The split
files freeze which pieces and layouts are for training and which for testing.

A piece's own frame has its origin on the floor, in the middle of its footprint, and +x where its front
looks. Nothing of it is ever touched: furniture is part of how a scene looks.
"""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from envs.randomization.procedural.noise import Stream
from envs.scenario import GeomCfg, Rgba
from envs.scenario.places import places_of

VARIANTS = 20
"""Pieces of each kind."""

NUM_LAYOUTS = 60

_WOODS = ((0.42, 0.24, 0.11), (0.28, 0.14, 0.06), (0.55, 0.36, 0.19), (0.62, 0.46, 0.28), (0.15, 0.08, 0.05))
_PAINTS = (
    (0.78, 0.77, 0.73),
    (0.60, 0.62, 0.60),
    (0.12, 0.22, 0.30),
    (0.20, 0.32, 0.22),
    (0.45, 0.12, 0.10),
    (0.62, 0.48, 0.14),
    (0.08, 0.08, 0.09),
)
_FABRICS = (
    (0.30, 0.32, 0.36),
    (0.45, 0.38, 0.28),
    (0.10, 0.16, 0.28),
    (0.36, 0.12, 0.12),
    (0.16, 0.26, 0.17),
    (0.55, 0.50, 0.42),
)
_METALS = ((0.55, 0.55, 0.57), (0.10, 0.10, 0.11), (0.48, 0.36, 0.16))
_LEAVES = ((0.07, 0.22, 0.05), (0.12, 0.28, 0.08), (0.05, 0.16, 0.08))

Colour = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Piece:
    """One piece of furniture in its own frame.

    Attributes:
        name: Its name.
        geoms: What it is made of.
        half_depth_m: Half of its footprint along x.
        half_width_m: Half of its footprint along y.
    """

    name: str
    geoms: tuple[GeomCfg, ...]
    half_depth_m: float
    half_width_m: float

    @property
    def radius(self) -> float:
        """Radius of a circle about its middle that its footprint fits into, m."""
        return math.hypot(self.half_depth_m, self.half_width_m)


def _box(size: Sequence[float], pos: Sequence[float], colour: Colour) -> GeomCfg:
    """A box of full ``size`` whose bottom's middle is ``pos``."""
    x, y, z = size
    return _geom("box", (x / 2, y / 2, z / 2), (pos[0], pos[1], pos[2] + z / 2), colour)


def _pillar(radius: float, height: float, z: float, colour: Colour) -> GeomCfg:
    return _geom("cylinder", (radius, height / 2), (0.0, 0.0, z + height / 2), colour)


def _geom(shape, size, pos, colour: Colour) -> GeomCfg:
    rgba: Rgba = (*colour, 1.0)
    x, y, z = (round(float(v), 4) for v in pos)
    size = tuple(round(float(v), 4) for v in size)
    return GeomCfg(shape=shape, size=size, pos=(x, y, z), rgba=rgba, collides=False)


def shade(colour: Colour, factor: float) -> Colour:
    """Returns a colour that is lighter or darker by a factor."""
    red, green, blue = (round(min(1.0, factor * part), 4) for part in colour)
    return red, green, blue


def _cabinet(s: Stream) -> list[GeomCfg]:
    """A body with two doors and their handles, under a top."""
    depth, width, height = s.uniform(0.35, 0.55), s.uniform(0.7, 1.1), s.uniform(0.7, 2.0)
    body, metal = s.pick(_WOODS + _PAINTS), s.pick(_METALS)
    door, front = shade(body, s.uniform(0.75, 1.25)), depth / 2
    parts = [_box((depth, width, height), (0, 0, 0), body)]
    for side in (-1, 1):
        parts.append(_box((0.02, 0.46 * width, 0.9 * height), (front, side * 0.24 * width, 0.06), door))
        parts.append(_box((0.03, 0.02, 0.14), (front + 0.02, side * 0.05 * width, 0.55 * height), metal))
    return [*parts, _box((depth + 0.05, width + 0.04, 0.03), (0, 0, height), shade(body, 0.8))]


def _bookcase(s: Stream) -> list[GeomCfg]:
    """A back between two sides, with shelves and a row of books on each."""
    depth, width, height = s.uniform(0.25, 0.35), s.uniform(0.6, 1.1), s.uniform(1.0, 1.9)
    wood = s.pick(_WOODS + _PAINTS[:2])
    parts = [_box((0.02, width, height), (-depth / 2, 0, 0), shade(wood, 0.7))]
    parts += [_box((depth, 0.03, height), (0, side * width / 2, 0), wood) for side in (-1, 1)]
    for row in range(2):
        z = height * (0.28 + 0.36 * row)
        length = s.uniform(0.4, 0.9) * width
        books = (0.6 * depth, length, s.uniform(0.17, 0.26))
        parts.append(_box((depth, width, 0.03), (0, 0, z), wood))
        parts.append(_box(books, (0, (width - length) / 2 - 0.03, z + 0.03), s.pick(_PAINTS)))
    return [*parts, _box((depth, width, 0.03), (0, 0, height), wood)]


def _shelf(s: Stream) -> list[GeomCfg]:
    """Open shelves between two posts, with boxes on them."""
    depth, width, height = s.uniform(0.3, 0.4), s.uniform(0.7, 1.1), s.uniform(0.9, 1.7)
    wood, metal = s.pick(_WOODS), s.pick(_METALS)
    parts = [_box((depth, 0.03, height), (0, side * width / 2, 0), metal) for side in (-1, 1)]
    parts += [_box((depth, width, 0.03), (0, 0, z * height), wood) for z in (0.2, 0.55, 0.95)]
    for z in (0.2, 0.55, 0.95):
        size = (0.7 * depth, s.uniform(0.2, 0.45), s.uniform(0.12, 0.25))
        place = (0, s.uniform(-0.25, 0.25) * width, z * height + 0.03)
        parts.append(_box(size, place, s.pick(_PAINTS + _FABRICS)))
    return parts


def _drawers(s: Stream) -> list[GeomCfg]:
    """A chest with three drawers and their handles."""
    depth, width, height = s.uniform(0.4, 0.5), s.uniform(0.5, 1.0), s.uniform(0.6, 1.1)
    body, metal = s.pick(_WOODS + _PAINTS), s.pick(_METALS)
    front, each = shade(body, s.uniform(0.75, 1.25)), height / 3
    parts = [_box((depth, width, height), (0, 0, 0), body)]
    for row in range(3):
        z = each * row
        parts.append(_box((0.02, 0.92 * width, 0.85 * each), (depth / 2, 0, z + 0.07 * each), front))
        parts.append(_box((0.03, 0.3 * width, 0.02), (depth / 2 + 0.02, 0, z + 0.5 * each), metal))
    return parts


def _sofa(s: Stream) -> list[GeomCfg]:
    """Seat, back, two arms and two cushions."""
    depth, width, seat = s.uniform(0.6, 0.75), s.uniform(0.9, 1.15), s.uniform(0.36, 0.44)
    fabric = s.pick(_FABRICS)
    cushion = s.pick((shade(fabric, 1.3), *_PAINTS))
    parts = [
        _box((depth, width, seat), (0, 0, 0.0), fabric),
        _box((0.18, width, s.uniform(0.35, 0.5)), (0.09 - depth / 2, 0, seat), fabric),
    ]
    for side in (-1, 1):
        place = (0, side * (width / 2 - 0.07), seat)
        parts.append(_box((depth, 0.14, 0.2), place, shade(fabric, 0.85)))
        place = (0.26 - depth / 2, side * 0.2 * width, seat)
        parts.append(_box((0.14, 0.3 * width, 0.3), place, cushion))
    return parts


def _sideboard(s: Stream) -> list[GeomCfg]:
    """A low board on feet, with a screen on it."""
    depth, width, height = s.uniform(0.35, 0.45), s.uniform(0.9, 1.15), s.uniform(0.4, 0.6)
    body, black = s.pick(_WOODS + _PAINTS), (0.02, 0.02, 0.025)
    screen = s.uniform(0.6, 0.9) * width
    parts = [_box((0.9 * depth, 0.04, 0.12), (0, side * 0.42 * width, 0), black) for side in (-1, 1)]
    return [
        *parts,
        _box((depth, width, height - 0.12), (0, 0, 0.12), body),
        _box((0.02, 0.47 * width, height - 0.2), (depth / 2, 0.24 * width, 0.16), shade(body, 0.8)),
        _box((0.02, 0.47 * width, height - 0.2), (depth / 2, -0.24 * width, 0.16), shade(body, 1.2)),
        _box((0.15, 0.2, 0.05), (0, 0, height), black),
        _box((0.04, screen, 0.58 * screen), (0, 0, height + 0.05), black),
    ]


def _chair(s: Stream) -> list[GeomCfg]:
    """A seat and a back on four legs."""
    side, seat = s.uniform(0.38, 0.46), s.uniform(0.42, 0.5)
    frame, cover = s.pick(_WOODS + _METALS), s.pick(_WOODS + _FABRICS + _PAINTS)
    reach = side / 2 - 0.02
    corners = [(x * reach, y * reach) for x in (-1, 1) for y in (-1, 1)]
    legs = [_box((0.04, 0.04, seat), (x, y, 0), frame) for x, y in corners]
    back = _box((0.04, side, s.uniform(0.35, 0.5)), (0.02 - side / 2, 0, seat + 0.05), cover)
    return [*legs, _box((side, side, 0.05), (0, 0, seat), cover), back]


def _table(s: Stream) -> list[GeomCfg]:
    """A small table with a vase."""
    depth, width, height = s.uniform(0.35, 0.5), s.uniform(0.35, 0.6), s.uniform(0.45, 0.72)
    wood, leg = s.pick(_WOODS + _PAINTS), s.pick(_WOODS + _METALS)
    corners = [(x * (depth / 2 - 0.03), y * (width / 2 - 0.03)) for x in (-1, 1) for y in (-1, 1)]
    parts = [_box((0.04, 0.04, height), (x, y, 0), leg) for x, y in corners]
    vase = _pillar(s.uniform(0.05, 0.09), s.uniform(0.15, 0.3), height + 0.03, s.pick(_PAINTS))
    return [*parts, _box((depth, width, 0.03), (0, 0, height), wood), vase]


def _crates(s: Stream) -> list[GeomCfg]:
    """A pile of three boxes."""
    parts, z, size = [], 0.0, s.uniform(0.4, 0.52)
    for _ in range(3):
        height = s.uniform(0.2, 0.38)
        offset = (s.uniform(-0.03, 0.03), s.uniform(-0.03, 0.03), z)
        parts.append(_box((size, size * s.uniform(0.8, 1.0), height), offset, s.pick(_WOODS + _PAINTS)))
        z, size = z + height, size * s.uniform(0.7, 0.95)
    return parts


def _plant(s: Stream) -> list[GeomCfg]:
    """A pot, a stem and two crowns of leaves."""
    pot, stem, crown = s.uniform(0.25, 0.45), s.uniform(0.2, 0.5), s.uniform(0.18, 0.28)
    top = pot + stem
    leaves = s.pick(_LEAVES)
    return [
        _pillar(s.uniform(0.13, 0.2), pot, 0.0, s.pick(_PAINTS + _WOODS)),
        _pillar(0.025, stem, pot, (0.2, 0.12, 0.05)),
        _geom("sphere", (crown,), (0.04, 0.05, top + 0.4 * crown), leaves),
        _geom("sphere", (0.75 * crown,), (-0.05, -0.08, top + 1.3 * crown), shade(leaves, 1.35)),
    ]


def _lamp(s: Stream) -> list[GeomCfg]:
    """A lamp stand: foot, pole and shade."""
    height, metal = s.uniform(0.9, 1.6), s.pick(_METALS)
    return [
        _pillar(s.uniform(0.13, 0.18), 0.03, 0.0, metal),
        _pillar(0.015, height, 0.03, metal),
        _pillar(s.uniform(0.14, 0.22), s.uniform(0.2, 0.3), height - 0.1, s.pick(_FABRICS + _PAINTS[:2])),
    ]


def _stool(s: Stream) -> list[GeomCfg]:
    """A round seat on a pole and a foot."""
    height, metal = s.uniform(0.45, 0.75), s.pick(_METALS)
    return [
        _pillar(s.uniform(0.16, 0.2), 0.03, 0.0, metal),
        _pillar(0.03, height, 0.03, metal),
        _pillar(s.uniform(0.16, 0.2), 0.07, height, s.pick(_FABRICS + _WOODS)),
    ]


AT_WALL: Mapping[str, Callable[[Stream], list[GeomCfg]]] = {
    "cabinet": _cabinet,
    "bookcase": _bookcase,
    "shelf": _shelf,
    "drawers": _drawers,
    "sofa": _sofa,
    "sideboard": _sideboard,
}
IN_CORNER: Mapping[str, Callable[[Stream], list[GeomCfg]]] = {
    "chair": _chair,
    "table": _table,
    "crates": _crates,
    "plant": _plant,
    "lamp": _lamp,
    "stool": _stool,
}
_KINDS = {**AT_WALL, **IN_CORNER}

PIECES = tuple(f"{kind}-{variant:02d}" for kind in _KINDS for variant in range(VARIANTS))
"""Names of all pieces."""

LAYOUTS = tuple(f"layout-{index:02d}" for index in range(NUM_LAYOUTS))
"""Names of all layouts."""


@functools.lru_cache(maxsize=len(PIECES))
def piece(name: str) -> Piece:
    """Returns the piece of that name, one of :data:`PIECES`."""
    kind, _, variant = name.rpartition("-")
    geoms = tuple(_KINDS[kind](Stream("furniture", kind, int(variant))))
    halves = [_half_extents(geom) for geom in geoms]
    depth, width = (
        max(abs(geom.pos[axis]) + half[axis] for geom, half in zip(geoms, halves, strict=True))
        for axis in (0, 1)
    )
    return Piece(name, geoms, depth, width)


def _half_extents(geom: GeomCfg) -> tuple[float, float]:
    return (geom.size[0], geom.size[1]) if geom.shape == "box" else (geom.size[0], geom.size[0])


@functools.lru_cache(maxsize=NUM_LAYOUTS)
def layout(name: str) -> Mapping[str, str]:
    """Returns the kind of furniture by place, without the empty places."""
    stream = Stream("layout", int(name.rpartition("-")[2]))
    kinds = {}
    for place in places_of(1.0).values():
        corner = place.kind == "corner"
        if stream.chance(0.7 if corner else 0.8):
            kinds[place.name] = stream.pick(list(IN_CORNER if corner else AT_WALL))
    return kinds

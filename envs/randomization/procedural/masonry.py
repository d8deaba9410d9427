"""Laid pieces with joints: bricks, ceramic and patterned tiles, mosaic, flagstones."""

import numpy as np

from envs.randomization.procedural import palettes
from envs.randomization.procedural.layouts import Pieces, courses
from envs.randomization.procedural.noise import (
    Field,
    Stream,
    cells,
    coordinates,
    fractal,
    grain,
    noise,
    relief,
    sine,
    smoothstep,
)
from envs.randomization.procedural.palettes import blend, mix, paint, shade, tinted
from envs.randomization.procedural.stone import flat, marble


def _joint(stream: Stream, size: int) -> np.ndarray:
    """Returns grout or mortar, (size, size, 3)."""
    rgb = flat(stream, size, stream.pick(palettes.GROUTS), 10)
    return shade(rgb, 1 + 0.07 * noise(stream, 100, 100, size) + 0.05 * grain(stream, size))


def bricks(stream: Stream, size: int) -> np.ndarray:
    """A brick wall in running, third or stack bond; brick faces are rough and differ in colour."""
    codes = palettes.BRICKS[stream.pick(tuple(palettes.BRICKS))]
    rows = stream.pick((8, 10, 12))
    cols = max(2, rows // 3 + stream.integer(0, 1))
    bond = stream.pick((0.5, 0.5, 0.5, 0.0, 0.25 if rows % 4 == 0 else 0.5))
    wobble = stream.uniform(0.001, 0.005)
    rough = [noise(stream, 40, 40, size) * wobble for _ in range(2)]
    pieces = courses(size, rows, cols, bond, du=rough[0], dv=rough[1])
    palette = np.stack([tinted(stream, code, 10) for code in codes])
    which = np.floor(stream.array(0.0, len(codes), pieces.count)).astype(np.int32)
    own = palette[which] * stream.array(0.88, 1.12, pieces.count)[:, None]
    face = fractal(stream, size, rows=12, cols=12, octaves=5, gain=0.65)
    rgb = shade(pieces.each(own), 1 + 0.12 * face + 0.05 * grain(stream, size))
    width = stream.uniform(0.05, 0.1)
    solid = smoothstep(pieces.edge, width * 0.7, width)
    height = np.clip(pieces.edge / width, 0, 1.5) + 0.15 * face
    return shade(mix(_joint(stream, size), rgb, solid), relief(height, 0.22))


def _glaze(stream: Stream, size: int, pieces: Pieces, codes: list[str], amount: float) -> np.ndarray:
    """Returns glazed tiles, each of one of ``codes`` and a little different."""
    palette = np.stack([tinted(stream, code, 6) for code in codes])
    which = np.floor(stream.array(0.0, len(codes), pieces.count)).astype(np.int32)
    own = palette[which] * stream.array(1 - amount, 1 + amount, pieces.count)[:, None]
    cloud = fractal(stream, size, rows=6, cols=6, octaves=4)
    return shade(pieces.each(own), 1 + 0.03 * cloud)


def _lay(stream: Stream, size: int, rgb: np.ndarray, edge: Field, width: float) -> np.ndarray:
    """Puts joints between tiles and rounds the tiles' rims."""
    solid = smoothstep(edge, 0.6 * width, width)
    rim = np.clip(edge / (2.5 * width), 0, 1)
    return mix(_joint(stream, size), shade(rgb, relief(rim, 0.25)), solid)


def tiles(stream: Stream, size: int) -> np.ndarray:
    """Ceramic tiles: square, chequered, subway, mosaic, or cut from marble."""
    kind = stream.pick(("square", "chequer", "subway", "mosaic", "marble", "wide"))
    codes = [stream.pick(palettes.CERAMICS) for _ in range(2)]
    if kind == "chequer":
        count = stream.pick((4, 6, 8))
        pieces = courses(size, count, count, 0.0)
        odd = ((pieces.piece // count + pieces.piece % count) % 2).astype(np.float32)
        light, dark = (
            _glaze(stream, size, pieces, [code], 0.03)
            for code in (codes[0], stream.pick(("22262a", "7c2f2a", "2f6272", "4c5459", "c79a6b")))
        )
        return _lay(stream, size, mix(light, dark, odd), pieces.edge, 0.025)
    if kind == "mosaic":
        count = stream.pick((16, 20, 24))
        pieces = courses(size, count, count, 0.0)
        shades = [codes[0], codes[0], codes[1], stream.pick(palettes.CERAMICS)]
        return _lay(stream, size, _glaze(stream, size, pieces, shades, 0.12), pieces.edge, 0.08)
    rows, cols, shift = {
        "square": (stream.pick((3, 4, 5, 6)), 0, 0.0),
        "marble": (stream.pick((2, 3, 4)), 0, 0.0),
        "subway": (stream.pick((8, 10, 12)), 4, 0.5),
        "wide": (4, 2, stream.pick((0.0, 0.5))),
    }[kind]
    pieces = courses(size, rows, cols or rows, shift)
    if kind == "marble":
        rgb = _cut(stream, marble(stream, size), pieces)
    else:
        rgb = _glaze(stream, size, pieces, codes[:1], stream.uniform(0.01, 0.08))
    return _lay(stream, size, rgb, pieces.edge, 0.05 if kind == "subway" else 0.02)


def _cut(stream: Stream, slab: np.ndarray, pieces: Pieces) -> np.ndarray:
    """Cuts every tile from its own place of a slab."""
    size = slab.shape[0]
    place = np.floor(stream.array(0.0, size, 2, pieces.count)).astype(np.int32)
    row, col = np.indices((size, size), dtype=np.int32)
    index = (row + pieces.each(place[0])) % size * size + (col + pieces.each(place[1])) % size
    return np.take(slab.reshape(-1, 3), index, axis=0)


def hexagons(stream: Stream, size: int) -> np.ndarray:
    """Hexagonal tiles of one to three colours."""
    rows, cols = stream.pick(((8, 7), (14, 12), (16, 14), (22, 19)))
    first, second, site = cells(stream, size, rows, cols, jitter=0.0, stagger=True)
    pieces = Pieces(site, rows * cols, first, first, (second - first) * 0.5)
    codes = [stream.pick(palettes.CERAMICS) for _ in range(stream.integer(1, 3))]
    return _lay(stream, size, _glaze(stream, size, pieces, codes, 0.05), pieces.edge, 0.05)


def encaustic(stream: Stream, size: int) -> np.ndarray:
    """Patterned cement tiles: one motif, symmetrical in every tile."""
    count = stream.pick((3, 4, 5))
    pieces = courses(size, count, count, 0.0)
    x, y = np.abs(pieces.along - 0.5) * 2, np.abs(pieces.across - 0.5) * 2
    low, high = np.minimum(x, y), np.maximum(x, y)
    radius = np.sqrt(x * x + y * y)
    corner = np.sqrt((1 - x) * (1 - x) + (1 - y) * (1 - y))
    soft = 0.03 * count / 4
    petal = radius + 0.35 * low - stream.uniform(0.1, 0.4) * high
    r = stream.uniform(0.35, 0.75)
    motifs = (
        lambda: smoothstep(radius, r, r + soft),
        lambda: smoothstep(x + y, 1.4 * r, 1.4 * r + soft),
        lambda: smoothstep(petal, 0.8 * r, 0.8 * r + soft),
        lambda: smoothstep(corner, r, r + soft),
        lambda: smoothstep(np.abs(corner - 1.2 * r), 0.06, 0.06 + soft),
        lambda: smoothstep(np.abs(x - y), 0.1, 0.1 + soft),
        lambda: smoothstep(sine(radius * 2 + 0.25), -0.05, 0.05 + soft),
    )
    rgb = flat(stream, size, stream.pick(palettes.CERAMICS[:4]), 8)
    for motif in stream.order(len(motifs))[: stream.integer(3, 4)]:
        rgb = mix(tinted(stream, stream.pick(palettes.CERAMICS), 10), rgb, motifs[motif]())
    worn = 1 + 0.06 * fractal(stream, size, rows=5, cols=5, octaves=5) + 0.03 * grain(stream, size)
    return _lay(stream, size, shade(rgb, worn), pieces.edge, 0.014)


def paving(stream: Stream, size: int) -> np.ndarray:
    """Flagstones and cobbles: irregular or squared stones with sandy joints."""
    code = stream.pick(palettes.STONES)
    if stream.chance(0.5):
        scale = stream.integer(4, 9)
        first, second, site = cells(stream, size, scale, scale, jitter=0.75)
        edge, count = (second - first) * 0.6 + 0.02 * noise(stream, 30, 30, size), scale * scale
    else:
        rows = stream.pick((6, 8))
        rough = [noise(stream, 26, 26, size) * 0.004 for _ in range(2)]
        pieces = courses(size, rows, stream.pick((rows, rows // 2)), 0.5, du=rough[0], dv=rough[1])
        edge, site, count = pieces.edge, pieces.piece, pieces.count
    own = np.stack([tinted(stream, code, 22) for _ in range(6)])
    own = own[np.floor(stream.array(0.0, 6.0, count)).astype(np.int32)]
    face = fractal(stream, size, rows=8, cols=8, octaves=6, gain=0.62)
    rgb = shade(np.take(own, site, axis=0), 1 + 0.12 * face + 0.04 * grain(stream, size))
    width = stream.uniform(0.05, 0.1)
    height = np.clip(edge / (2 * width), 0, 1) + 0.22 * face
    return shade(mix(_joint(stream, size), rgb, smoothstep(edge, 0.6 * width, width)), relief(height, 0.25))


def rubble(stream: Stream, size: int) -> np.ndarray:
    """A dry-stone wall: flat stones of many shades with deep shadows between."""
    rows = stream.integer(9, 13)
    first, second, site = cells(stream, size, rows, rows // 2, jitter=0.75)
    ramp = blend([tinted(stream, stream.pick(palettes.STONES), 14) for _ in range(3)])
    face = fractal(stream, size, rows=10, cols=8, octaves=6, gain=0.62)
    tone = np.take(stream.array(0.0, 1.0, rows * (rows // 2)), site) + 0.12 * face
    edge = (second - first) + 0.03 * face
    height = np.clip(edge * 3, 0, 1) + 0.3 * face
    rgb = shade(paint(ramp, tone), relief(height, 0.3) + 0.04 * grain(stream, size))
    return shade(rgb, 0.3 + 0.7 * smoothstep(edge, 0.02, 0.16))


def diamonds(stream: Stream, size: int) -> np.ndarray:
    """Small diamond tiles set on the diagonal."""
    u, v = coordinates(size)
    count = stream.pick((6, 8, 10))
    x, y = (u + v) * count, (u - v) * count
    col, row = np.floor(x), np.floor(y)
    fx, fy = x - col, y - row
    number = (col.astype(np.int32) % count) * count + row.astype(np.int32) % count
    edge = np.minimum(np.minimum(fx, 1 - fx), np.minimum(fy, 1 - fy))
    pieces = Pieces(number, count * count, fx, fy, edge)
    codes = [stream.pick(palettes.CERAMICS) for _ in range(stream.integer(1, 3))]
    return _lay(stream, size, _glaze(stream, size, pieces, codes, 0.08), edge, 0.035)

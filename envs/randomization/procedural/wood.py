"""Wood: boards, planks, parquet, end-grain blocks, bamboo and painted panelling."""

import numpy as np

from envs.randomization.procedural import palettes
from envs.randomization.procedural.layouts import Pieces, basket, courses, gather, herringbone
from envs.randomization.procedural.noise import (
    Field,
    Stream,
    coordinates,
    fractal,
    grain,
    noise,
    periodic,
    relief,
    smoothstep,
)
from envs.randomization.procedural.palettes import blend, mix, paint, shade, tinted


def _ring_profile(stream: Stream, rings: int) -> np.ndarray:
    """Returns one period of the tone across growth rings: slow early wood, then a dark late line."""
    width = stream.array(0.4, 1.6, rings)
    depth = stream.array(0.3, 1.0, rings)
    edges = np.cumsum(width.astype(np.float64))  # sequential, so exact in order on every machine
    x = np.arange(2048) * (edges[-1] / 2048)
    ring = np.minimum(np.searchsorted(edges, x, side="right"), rings - 1)
    start = np.concatenate([[0.0], edges[:-1]])
    t = (x - start[ring]) / width[ring]
    saw = t * t * t * (1 - np.clip((t - 0.9) / 0.1, 0, 1))
    return (saw * depth[ring]).astype(np.float32)


def grain_tone(stream: Stream, size: int, *, boards: int = 1, figure: float = 1.0) -> Field:
    """Returns the tone of wood whose grain runs across the texture: 0 is dark, 1 light.

    Args:
        stream: Source of the figure.
        size: Pixels along a side.
        boards: Boards that will be cut from it; more boards, finer grain.
        figure: How far the rings wander: 0 is quarter-sawn, 2 has wide cathedrals.
    """
    _, v = coordinates(size)
    wander = noise(stream, 2 + boards // 4, 2, size) * (0.10 * figure)
    wander += noise(stream, 5, 3, size) * (0.035 * figure)
    wander += noise(stream, 16, 8, size) * 0.004
    rings = _ring_profile(stream, stream.integer(14, 30))
    ring = periodic(rings, v + wander)
    fibre = noise(stream, 256, 10, size) * 0.6 + noise(stream, 128, 5, size) * 0.4
    pores = smoothstep(noise(stream, 256, 40, size), 0.55, 1.1)
    cloud = noise(stream, 6, 2, size)
    contrast = stream.uniform(0.25, 0.65)
    return 0.68 - contrast * ring + 0.14 * fibre - 0.22 * pores + 0.10 * cloud


def _species(stream: Stream) -> list[np.ndarray]:
    codes = palettes.WOODS[stream.pick(tuple(palettes.WOODS))]
    change = stream.array(-5.0, 5.0, 3) + stream.uniform(-12.0, 12.0)
    return [np.clip(palettes.color(code) + change, 4.0, 250.0) for code in codes]


def _boards(stream: Stream, size: int, pieces: Pieces, *, spread: float, gap: float, figure: float) -> Field:
    """Colours wooden pieces: each has its own place in the tree and its own tone.

    Args:
        stream: Source of the wood.
        size: Pixels along a side.
        pieces: How the surface is divided.
        spread: Largest difference of tone between pieces.
        gap: Half width of the dark joint, in widths of a piece.
        figure: See :func:`grain_tone`.
    """
    ramp = blend(_species(stream))
    tone = gather(grain_tone(stream, size, boards=pieces.count, figure=figure), pieces, stream)
    tone += pieces.each(stream.array(-spread, spread, pieces.count))
    rgb = paint(ramp, tone)
    joint = smoothstep(pieces.edge, 0.2 * gap, gap)
    return shade(rgb, 0.38 + 0.62 * joint)


def wood(stream: Stream, size: int) -> np.ndarray:
    """A table top: one slab, or a few wide boards glued edge to edge."""
    boards = stream.pick((1, 1, 3, 4, 5, 6))
    figure = stream.uniform(0.3, 1.8)
    if boards == 1:
        return paint(blend(_species(stream)), grain_tone(stream, size, figure=figure))
    pieces = courses(size, boards, 1, stream.array(0.0, 1.0, boards))
    whole = Pieces(pieces.piece, pieces.count, pieces.along, pieces.across, _sides(pieces))
    return _boards(stream, size, whole, spread=stream.uniform(0.03, 0.14), gap=0.012, figure=figure)


def _sides(pieces: Pieces) -> Field:
    """Returns the distance to the long edges only: such boards have no visible ends."""
    return np.minimum(pieces.across, 1 - pieces.across)


def planks(stream: Stream, size: int) -> np.ndarray:
    """A floor of long planks whose ends are staggered at random."""
    rows = stream.integer(5, 10)
    pieces = courses(size, rows, stream.integer(1, 2), stream.array(0.0, 1.0, rows))
    gap = stream.uniform(0.015, 0.05)
    return _boards(
        stream, size, pieces, spread=stream.uniform(0.06, 0.26), gap=gap, figure=stream.uniform(0.3, 1.2)
    )


def butcher(stream: Stream, size: int) -> np.ndarray:
    """A butcher-block top: narrow staves of random shade."""
    rows = stream.integer(10, 20)
    pieces = courses(size, rows, stream.integer(2, 3), stream.array(0.0, 1.0, rows))
    return _boards(
        stream, size, pieces, spread=stream.uniform(0.12, 0.34), gap=0.03, figure=stream.uniform(0.2, 0.6)
    )


def parquet(stream: Stream, size: int) -> np.ndarray:
    """Parquet: herringbone or basket weave."""
    if stream.chance(0.6):
        pieces = herringbone(size, stream.integer(3, 5), stream.integer(1, 2))
    else:
        pieces = basket(size, stream.integer(4, 6), stream.pick((4, 6)))
    gap = stream.uniform(0.03, 0.06)
    return _boards(stream, size, pieces, spread=stream.uniform(0.08, 0.28), gap=gap, figure=0.4)


def bamboo(stream: Stream, size: int) -> np.ndarray:
    """Pressed bamboo: thin strips with a node now and then."""
    rows = stream.integer(16, 28)
    pieces = courses(size, rows, 2, stream.array(0.0, 1.0, rows))
    light = tinted(stream, stream.pick(("d9b878", "c79a58", "8a5a2c", "e6cf9a", "b5a06a")), 14)
    tone = 0.55 + 0.12 * noise(stream, 256, 6, size) + pieces.each(stream.array(-0.25, 0.25, pieces.count))
    node = pieces.each(stream.array(0.2, 0.8, pieces.count)) - pieces.along
    tone -= 0.35 * (1 - smoothstep(np.abs(node), 0.004, 0.014))
    rgb = paint(blend([light * 0.72, light, np.clip(light * 1.12, 0, 250)]), tone)
    return shade(rgb, 0.7 + 0.3 * smoothstep(pieces.edge, 0.02, 0.12))


def panel(stream: Stream, size: int) -> np.ndarray:
    """Painted or oiled wall panelling: upright boards with a bevelled groove between them."""
    boards = stream.integer(6, 12)
    pieces = courses(size, boards, 1, 0.0)
    groove = smoothstep(pieces.across, 0.0, 0.05) * smoothstep(1 - pieces.across, 0.0, 0.03)
    if stream.chance(0.5):
        base = tinted(stream, stream.pick(palettes.PAINTS), 10)
        tone = grain_tone(stream, size, boards=boards, figure=0.5)
        rgb = shade(np.broadcast_to(base, (size, size, 3)), 0.93 + 0.1 * tone)
    else:
        rgb = _boards(stream, size, pieces, spread=0.12, gap=0.01, figure=0.8)
    light = np.where(pieces.across < 0.5, 1.0, 0.97).astype(np.float32)
    return np.ascontiguousarray(shade(rgb, (0.5 + 0.5 * groove) * light).transpose(1, 0, 2))


_CHIP_STAINS = (
    ("8f6636", "c29a5c", "dcc08a"),
    ("6a6157", "968c7f", "bfb6a8"),
    ("5a3a20", "85592f", "ab7d49"),
    ("b39468", "d8c096", "eadcbc"),
    ("4a4038", "6b5f52", "8f8272"),
)


def chipboard(stream: Stream, size: int) -> np.ndarray:
    """Oriented strand board: overlapping flakes of wood."""
    stain = stream.pick(_CHIP_STAINS)
    base = [tinted(stream, code, 12) for code in stain]
    tone = np.full((size, size), 0.5, dtype=np.float32)
    for turned in (False, True, False):
        rows, cols = stream.integer(34, 46), stream.integer(8, 12)
        shift = noise(stream, 12, 12, size) * 0.012
        pieces = courses(size, rows, cols, stream.array(0.0, 1.0, rows), dv=shift, du=shift)
        shown = pieces.each((stream.array(0.0, 1.0, pieces.count) < 0.45).astype(np.float32))
        flake = pieces.each(stream.array(0.15, 0.95, pieces.count)) + 0.08 * noise(stream, 200, 12, size)
        flake -= 0.25 * (1 - smoothstep(pieces.edge, 0.02, 0.2))
        if turned:
            shown, flake = shown.T, flake.T
        tone = tone + (flake - tone) * shown
    return shade(paint(blend(base), tone), relief(tone, 0.25) + 0.03 * grain(stream, size))


def end_grain(stream: Stream, size: int) -> np.ndarray:
    """An end-grain chopping block: small squares showing arcs of rings."""
    rows = stream.integer(6, 10)
    pieces = courses(size, rows, rows, stream.array(0.0, 1.0, rows))
    ramp = blend(_species(stream))
    x = pieces.along + pieces.each(stream.array(-1.5, 1.5, pieces.count))
    y = pieces.across + pieces.each(stream.array(0.6, 1.8, pieces.count))
    radius = np.sqrt(x * x + y * y) * 0.16 + pieces.each(stream.array(0.0, 1.0, pieces.count))
    ring = periodic(_ring_profile(stream, 16), radius + 0.004 * noise(stream, 32, 32, size))
    tone = 0.62 - 0.4 * ring + 0.07 * grain(stream, size)
    tone += pieces.each(stream.array(-0.2, 0.2, pieces.count))
    return shade(paint(ramp, tone), 0.5 + 0.5 * smoothstep(pieces.edge, 0.01, 0.04))


def inlay(stream: Stream, size: int) -> np.ndarray:
    """Two veneers laid as a chessboard or as stripes."""
    pieces = courses(size, 4, 4, 0.0) if stream.chance(0.5) else courses(size, 6, 1, 0.0)
    tone = grain_tone(stream, size, figure=0.7)
    turned = tone.T if stream.chance(0.5) else np.roll(tone, size // 3, axis=0)
    first, second = paint(blend(_species(stream)), tone), paint(blend(_species(stream)), turned)
    cols = 4 if pieces.count == 16 else 1
    odd = ((pieces.piece // cols + pieces.piece % cols) % 2).astype(np.float32)
    return shade(mix(first, second, odd), fractal(stream, size, rows=4, cols=4) * 0.03 + 1.0)

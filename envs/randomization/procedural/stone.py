"""Stone and cast stone: marble, granite, terrazzo, concrete, slate, travertine, plaster."""

import numpy as np

from envs.randomization.procedural import palettes
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


def flat(stream: Stream, size: int, code: str, amount: float = 12.0) -> np.ndarray:
    """Returns a whole texture of one colour near ``code``, (size, size, 3)."""
    return np.ascontiguousarray(np.broadcast_to(tinted(stream, code, amount), (size, size, 3)))


def _ridges(field: Field, width: float) -> Field:
    """Returns lines, 1 in their middle, where ``field`` crosses zero."""
    return 1 - smoothstep(np.abs(field), 0.0, width)


def marble(stream: Stream, size: int) -> np.ndarray:
    """Marble: clouds, a few long veins that follow one direction, and a net of fine ones."""
    ground, cloud, vein = (
        tinted(stream, code, 9) for code in palettes.MARBLES[stream.pick(tuple(palettes.MARBLES))]
    )
    u, v = coordinates(size)
    turbulence = fractal(stream, size, rows=2, cols=2, octaves=6, gain=0.55)
    across, down = stream.pick(((1, 1), (2, 1), (1, 2), (2, -1), (1, -1), (0, 2), (3, -2)))
    phase = across * u + down * v + stream.uniform(0.25, 0.55) * turbulence
    rgb = paint(blend([ground, cloud]), 0.5 + 0.55 * fractal(stream, size, rows=3, cols=3, octaves=5))
    strength = smoothstep(noise(stream, 3, 3, size), -0.5, 0.8)
    long = _ridges(sine(phase), stream.uniform(0.05, 0.18)) * strength
    soft = _ridges(sine(phase + 0.1 * turbulence), 0.7) * strength
    fine = _ridges(fractal(stream, size, rows=4, cols=4, octaves=4, gain=0.5), 0.05)
    rgb = mix(rgb, vein, np.clip(0.85 * long + 0.25 * soft, 0, 0.95))
    rgb = mix(rgb, vein, fine * stream.uniform(0.1, 0.5))
    return shade(rgb, 1 + 0.015 * grain(stream, size))


def granite(stream: Stream, size: int) -> np.ndarray:
    """Granite: crystals of three sizes and a few colours."""
    colors = np.stack(
        [tinted(stream, code, 8) for code in palettes.GRANITES[stream.pick(tuple(palettes.GRANITES))]]
    )
    shares_of_colors = np.array([0.0, 0.45, 0.75, 0.92])
    coarse = stream.integer(18, 34)
    table: list[np.ndarray] = []  # colours of all crystals, and for each pixel which of them is on top
    top = np.zeros((size, size), dtype=np.int32)
    for scale, share in ((coarse, 1.0), (2 * coarse + 3, 0.45), (96, 0.25)):
        count = scale * scale
        _, _, crystal = cells(stream, size, scale, scale)
        which = np.searchsorted(shares_of_colors, stream.array(0.0, 1.0, count), side="right") - 1
        shown = np.take(stream.array(0.0, 1.0, count) < share, crystal)
        np.copyto(top, crystal + sum(map(len, table)), where=shown)
        table.append(colors[which] * stream.array(0.85, 1.15, count)[:, None])
    cloud = 1 + 0.08 * fractal(stream, size, rows=3, cols=3, octaves=3)
    rgb = np.take(np.concatenate(table), top, axis=0)
    return shade(rgb, cloud + 0.06 * grain(stream, size))


def terrazzo(stream: Stream, size: int) -> np.ndarray:
    """Terrazzo: angular chips of a few stones in a cement of another colour."""
    cement = stream.pick(("e8e4dc", "d6d2ca", "c9b8a8", "8d9092", "3a3c3f", "e3c9bb", "b9c4ba", "dfd8c4"))
    rgb = shade(flat(stream, size, cement, 8), 1 + 0.04 * grain(stream, size))
    chips = [tinted(stream, stream.pick(palettes.STONES + palettes.TEXTILES), 14) for _ in range(4)]
    largest = stream.integer(12, 22)
    for scale, share in ((3 * largest, 0.55), (largest, stream.uniform(0.35, 0.75))):
        first, second, site = cells(stream, size, scale, scale)
        count = scale * scale
        margin = np.take(stream.array(0.08, 0.4, count), site)
        shown = np.take((stream.array(0.0, 1.0, count) < share).astype(np.float32), site)
        color = np.stack(chips)[np.floor(stream.array(0.0, 4.0, count)).astype(np.int32)]
        color = np.take(color * stream.array(0.85, 1.12, count)[:, None], site, axis=0)
        mask = smoothstep(second - first - margin, 0.0, 0.04) * shown
        rgb = mix(rgb, color, mask)
    return shade(rgb, 1 + 0.03 * fractal(stream, size, rows=6, cols=6))


def concrete(stream: Stream, size: int) -> np.ndarray:
    """Concrete: clouds, stains, pores, and sometimes the joints of its formwork."""
    rgb = flat(stream, size, stream.pick(palettes.CONCRETES), 10)
    cloud = fractal(stream, size, rows=2, cols=2, octaves=7, gain=0.62)
    stain = smoothstep(fractal(stream, size, rows=3, cols=2, octaves=5), 0.2, 1.0)
    tone = 1 + stream.uniform(0.05, 0.13) * cloud - 0.1 * stain + 0.035 * grain(stream, size)
    scale = stream.integer(14, 26)
    first, _, site = cells(stream, size, scale, scale)
    radius = np.take(stream.array(-0.1, 0.12, scale * scale), site)
    tone *= 1 - 0.4 * (1 - smoothstep(first - radius, -0.02, 0.03))
    if stream.chance(0.4):
        u, v = coordinates(size)
        sheets = stream.integer(1, 2)
        seam = np.minimum(np.abs(u * sheets % 1 - 0.5), np.abs(v * 2 % 1 - 0.5) * sheets * 0.5)
        tone *= 1 - 0.35 * (1 - smoothstep(seam, 0.002, 0.007))
    return shade(rgb, tone)


def slate(stream: Stream, size: int) -> np.ndarray:
    """Slate and soapstone: cleft layers with a faint direction."""
    ramp = [
        tinted(stream, code, 8)
        for code in stream.pick(
            (
                ("26292c", "3c4145", "575d61"),
                ("2d322e", "48504a", "6a726a"),
                ("3a3330", "5a4c45", "80695a"),
                ("3f4450", "5b6272", "7d8696"),
                ("6a6d6c", "8b8e8b", "aaa9a2"),
            )
        )
    ]
    height = fractal(stream, size, rows=3, cols=2, octaves=7, gain=0.6)
    steps = height * stream.integer(3, 6)
    cleft = np.floor(steps) + smoothstep(steps - np.floor(steps), 0.0, 0.35)
    tone = 0.5 + 0.22 * fractal(stream, size, rows=2, cols=2, octaves=4) + 0.05 * cleft
    return shade(
        paint(blend(ramp), tone), relief(0.6 * height + 0.2 * cleft, 0.5) + 0.04 * grain(stream, size)
    )


def travertine(stream: Stream, size: int) -> np.ndarray:
    """Travertine and sandstone: sediment bands with elongated holes."""
    dark, light = stream.pick(
        (
            ("c2a67c", "e8d9bd"),
            ("a98b66", "d8c3a0"),
            ("b9b2a4", "e2ddd2"),
            ("b07f5c", "dcb896"),
            ("8f8577", "bdb3a3"),
        )
    )
    _, v = coordinates(size)
    bands = sine(stream.integer(2, 5) * v + 0.22 * fractal(stream, size, rows=5, cols=2, octaves=5))
    bands = 0.6 * bands + 0.7 * fractal(stream, size, rows=14, cols=2, octaves=4)
    rgb = paint(blend([tinted(stream, dark, 8), tinted(stream, light, 8)]), 0.5 + 0.4 * bands)
    holes = smoothstep(noise(stream, 64, 22, size) + 0.5 * noise(stream, 8, 4, size), 0.95, 1.25)
    tone = 1 + 0.04 * grain(stream, size) - 0.38 * holes * stream.uniform(0.2, 1.0)
    return shade(rgb, tone)


def plaster(stream: Stream, size: int) -> np.ndarray:
    """Plaster: smooth, trowelled, or rough-cast, in wall colours."""
    rgb = flat(stream, size, stream.pick(palettes.PAINTS[:14]), 12)
    kind = stream.pick(("smooth", "trowelled", "stucco", "venetian"))
    cloud = fractal(stream, size, rows=2, cols=2, octaves=5)
    if kind == "smooth":
        height = fractal(stream, size, rows=24, cols=24, octaves=3)
        return shade(rgb, (1 + 0.03 * cloud) * relief(height, 0.08) + 0.015 * grain(stream, size))
    if kind == "trowelled":
        stroke = fractal(stream, size, rows=5, cols=18, octaves=4, gain=0.6)
        other = fractal(stream, size, rows=18, cols=5, octaves=4, gain=0.6)
        return shade(rgb, (1 + 0.04 * cloud) * relief(np.maximum(stroke, other), 0.35))
    if kind == "stucco":
        first, _, _ = cells(stream, size, 44, 44)
        bumps = 0.7 - first + 0.4 * noise(stream, 100, 100, size)
        return shade(rgb, (1 + 0.03 * cloud) * relief(bumps, stream.uniform(0.3, 0.7)))
    patches = np.abs(fractal(stream, size, rows=4, cols=4, octaves=5, gain=0.6))
    tone = 0.9 + 0.16 * patches + 0.05 * cloud
    return shade(rgb, tone + 0.012 * grain(stream, size))


def asphalt(stream: Stream, size: int) -> np.ndarray:
    """Asphalt and fine gravel: pebbles bound in a dark or pale ground."""
    ground, stones = stream.pick(
        (("2c2c2d", ("4a4a4b", "5d5c5a", "74726e")), ("6a655c", ("9a9184", "b3a998", "857a6c")),
         ("4a4640", ("7a746a", "8f887c", "a39b8d")), ("8a8378", ("c2bbae", "a89f92", "d8d2c6")))
    )  # fmt: skip
    scale = stream.integer(40, 64)
    first, second, site = cells(stream, size, scale, scale)
    count = scale * scale
    palette = np.stack([tinted(stream, code, 10) for code in stones])
    color = palette[np.floor(stream.array(0.0, 3.0, count)).astype(np.int32)]
    color = np.take(color * stream.array(0.75, 1.2, count)[:, None], site, axis=0)
    edge = second - first - np.take(stream.array(0.0, 0.3, count), site)
    rgb = mix(flat(stream, size, ground, 8), color, smoothstep(edge, 0.0, 0.2))
    tone = 1 + 0.07 * fractal(stream, size, rows=2, cols=2, octaves=4)
    return shade(rgb, tone * relief(np.clip(edge, 0, 0.4), 0.6))

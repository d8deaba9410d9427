"""Painted, plastic, metal, rubber and cork surfaces."""

import numpy as np

from envs.randomization.procedural import palettes
from envs.randomization.procedural.layouts import courses
from envs.randomization.procedural.noise import Stream, cells, fractal, grain, noise, relief, smoothstep
from envs.randomization.procedural.palettes import blend, mix, paint, shade, tinted
from envs.randomization.procedural.stone import flat


def painted(stream: Stream, size: int) -> np.ndarray:
    """Wall paint: a roller's stipple, uneven cover, sometimes a second coat showing."""
    rgb = flat(stream, size, stream.pick(palettes.PAINTS), 16)
    stipple = relief(noise(stream, 128, 128, size) + noise(stream, 60, 60, size), stream.uniform(0.02, 0.07))
    cover = fractal(stream, size, rows=2, cols=3, octaves=4)
    if stream.chance(0.25):
        worn = smoothstep(fractal(stream, size, rows=4, cols=4, octaves=6, gain=0.6), 0.6, 0.9)
        rgb = mix(rgb, tinted(stream, stream.pick(palettes.CONCRETES), 10), 0.6 * worn)
    return shade(rgb, stipple * (1 + 0.03 * cover))


def laminate(stream: Stream, size: int) -> np.ndarray:
    """Laminate and solid surface: one colour, plain or finely speckled."""
    code = stream.pick(palettes.PAINTS + palettes.TEXTILES)
    rgb = flat(stream, size, code, 12)
    if stream.chance(0.6):
        for _ in range(stream.integer(1, 3)):
            speck = smoothstep(noise(stream, 160, 160, size), 0.75, 0.95)
            rgb = mix(rgb, tinted(stream, stream.pick(palettes.STONES + palettes.PAINTS), 20), 0.7 * speck)
    scuffs = fractal(stream, size, rows=3, cols=3, octaves=5)
    return shade(rgb, 1 + 0.02 * scuffs + 0.012 * grain(stream, size))


def metal(stream: Stream, size: int) -> np.ndarray:
    """Sheet metal: brushed, galvanized, rolled, or rusting."""
    rgb = flat(stream, size, stream.pick(palettes.METALS), 10)
    kind = stream.pick(("brushed", "brushed", "galvanized", "rolled", "rusty"))
    cloud = fractal(stream, size, rows=2, cols=2, octaves=4)
    if kind == "galvanized":
        _, _, spangle = cells(stream, size, 16, 16)
        tone = np.take(stream.array(0.82, 1.12, 256), spangle) + 0.04 * noise(stream, 64, 64, size)
        return shade(rgb, tone + 0.04 * cloud)
    brush = 0.6 * noise(stream, 256, 3, size) + 0.5 * noise(stream, 256, 12, size)
    if kind == "brushed":
        return shade(rgb, 1 + 0.09 * brush + 0.05 * cloud)
    blotch = fractal(stream, size, rows=3, cols=3, octaves=6, gain=0.62)
    if kind == "rolled":
        scratch = smoothstep(np.abs(noise(stream, 5, 40, size)), 0.0, 0.01)
        return shade(rgb, (0.9 + 0.1 * scratch) * (1 + 0.09 * blotch + 0.03 * brush))
    rust = [tinted(stream, code, 10) for code in ("4a2a1c", "7d4526", "a8653a")]
    mask = smoothstep(blotch, stream.uniform(-0.1, 0.4), 0.7)
    rusted = paint(blend(rust), 0.5 + 0.5 * fractal(stream, size, rows=10, cols=10, octaves=5, gain=0.65))
    return mix(shade(rgb, 1 + 0.05 * brush), rusted, mask)


def cork(stream: Stream, size: int) -> np.ndarray:
    """Pressed cork: granules of many browns and dark specks."""
    ramp = blend([tinted(stream, code, 12) for code in ("7a5230", "b58a5a", "d4b083")])
    scale = stream.integer(30, 50)
    first, second, site = cells(stream, size, scale, scale)
    tone = np.take(stream.array(0.25, 0.95, scale * scale), site) + 0.12 * noise(stream, 110, 110, size)
    tone -= 0.25 * (1 - smoothstep(second - first, 0.0, 0.15))
    specks = smoothstep(noise(stream, 90, 90, size), 0.8, 1.1)
    return shade(paint(ramp, tone), 1 - 0.45 * specks + 0.04 * grain(stream, size))


def rubber(stream: Stream, size: int) -> np.ndarray:
    """Rubber flooring: dark with coloured crumbs, or studded."""
    base = flat(stream, size, stream.pick(("1e1f21", "2b2d30", "3a3d40", "23303c", "3c2a26", "55585a")), 8)
    if stream.chance(0.4):
        count = stream.pick((10, 12, 16))
        pieces = courses(size, count, count, 0.0)
        x, y = pieces.along - 0.5, pieces.across - 0.5
        stud = 1 - smoothstep(np.sqrt(x * x + y * y), 0.26, 0.36)
        return shade(base, relief(stud, 0.35) + 0.1 * stud + 0.03 * grain(stream, size))
    first, _, site = cells(stream, size, 60, 60)
    shown = np.take((stream.array(0.0, 1.0, 3600) < stream.uniform(0.08, 0.3)).astype(np.float32), site)
    crumb = tinted(stream, stream.pick(palettes.TEXTILES), 14)
    mask = shown * (1 - smoothstep(first, 0.25, 0.4))
    return shade(
        mix(base, crumb, mask), 1 + 0.12 * noise(stream, 128, 128, size) + 0.06 * grain(stream, size)
    )

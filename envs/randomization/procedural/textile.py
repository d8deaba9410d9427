"""Woven, knotted and printed surfaces: table cloths, tartans, denim, carpets, leather, wallpaper."""

import numpy as np

from envs.randomization.procedural import palettes
from envs.randomization.procedural.layouts import courses
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
from envs.randomization.procedural.stone import flat


def _thread_colors(stream: Stream, threads: int, kind: str) -> np.ndarray:
    """Returns the colour of every thread of one direction, (threads, 3)."""
    first, second, third = (tinted(stream, stream.pick(palettes.TEXTILES), 10) for _ in range(3))
    index = np.arange(threads)
    if kind == "plain":
        return np.broadcast_to(first, (threads, 3))
    if kind == "gingham":
        return np.where(((index // (threads // stream.pick((8, 12, 16)))) % 2)[:, None] == 0, first, second)
    if kind == "stripes":
        band = np.where(index % (threads // 8) < stream.integer(2, threads // 16), 1, 0)
        return np.where(band[:, None] == 1, second, first)
    sett = stream.pick((24, 32, 48))  # tartan: a palindrome of bands
    folded = np.abs((index % (2 * sett)) - sett)
    edges = sorted(stream.integer(2, sett - 2) for _ in range(4))
    band = np.searchsorted(np.array(edges), folded)
    return np.stack([first, second, first, third, second])[band]


def fabric(stream: Stream, size: int) -> np.ndarray:
    """Cloth: threads over and under threads, plain or twill, dyed plain or in a pattern."""
    threads = 96
    kind = stream.pick(("plain", "plain", "gingham", "stripes", "tartan"))
    across = _thread_colors(stream, threads, kind)
    same = kind in ("gingham", "tartan") or stream.chance(0.4)
    down = across if same else np.broadcast_to(across[0] * stream.uniform(0.7, 1.15), across.shape)
    u, v = coordinates(size)
    x, y = u * threads, v * threads
    col, row = np.floor(x).astype(np.int32), np.floor(y).astype(np.int32)
    twill = stream.pick((1, 1, 2))
    over = ((col + row) // twill) % 2 == 0
    profile = np.where(over, 1 - np.abs(2 * (x - col) - 1), 1 - np.abs(2 * (y - row) - 1)).astype(np.float32)
    rgb = np.where(over[:, :, None], np.take(down, col, axis=0), np.take(across, row, axis=0))
    slub = np.where(over, noise(stream, 12, 96, size), noise(stream, 96, 12, size)).astype(np.float32)
    folds = fractal(stream, size, rows=2, cols=2, octaves=3)
    return shade(rgb, 0.72 + 0.3 * profile + 0.07 * slub + 0.04 * folds + 0.05 * grain(stream, size))


def carpet(stream: Stream, size: int) -> np.ndarray:
    """Carpet: tufts, plain, flecked, striped, or in square tiles."""
    loops = stream.pick((64, 80, 96))
    first, _, site = cells(stream, size, loops, loops, jitter=0.7)
    count = loops * loops
    base, other = (tinted(stream, stream.pick(palettes.TEXTILES), 12) for _ in range(2))
    u, _ = coordinates(size)
    kind = stream.pick(("plain", "flecked", "striped", "tiled", "worn"))
    tone = 0.75 + 0.3 * (0.9 - first) + np.take(stream.array(-0.13, 0.13, count), site)
    rgb = np.ascontiguousarray(np.broadcast_to(base, (size, size, 3)))
    if kind == "flecked":
        flecks = np.take((stream.array(0.0, 1.0, count) < stream.uniform(0.15, 0.4)).astype(np.float32), site)
        rgb = mix(rgb, other, flecks)
    elif kind == "striped":
        bands = periodic_bands(stream, u, stream.pick((2, 3, 4)))
        rgb = mix(rgb, other, bands)
    elif kind == "tiled":
        pieces = courses(size, 2, 2, 0.0)
        odd = ((pieces.piece // 2 + pieces.piece % 2) % 2).astype(np.float32)
        tone = tone * (0.94 + 0.12 * odd) * (0.8 + 0.2 * smoothstep(pieces.edge, 0.0, 0.015))
    else:
        tone += 0.07 * fractal(stream, size, rows=3, cols=3, octaves=5)
    return shade(rgb, tone + 0.06 * grain(stream, size))


def periodic_bands(stream: Stream, x: Field, count: int) -> Field:
    """Returns stripes of random widths, ``count`` times over the texture: 1 in a stripe, else 0."""
    edges = np.array(sorted(stream.uniform(0.05, 0.95) for _ in range(4)), dtype=np.float32)
    t = x * count - np.floor(x * count)
    return (smoothstep(t, edges[0], edges[0] + 0.01) - smoothstep(t, edges[1], edges[1] + 0.01)) + (
        smoothstep(t, edges[2], edges[2] + 0.01) - smoothstep(t, edges[3], edges[3] + 0.01)
    )


def leather(stream: Stream, size: int) -> np.ndarray:
    """Leather: a net of creases between small pads, and soft wear."""
    scale = stream.pick((28, 40, 52))
    first, second, _ = cells(stream, size, scale, scale)
    height = np.clip((second - first) * 2, 0, 0.5) + 0.12 * noise(stream, 80, 80, size)
    worn = fractal(stream, size, rows=3, cols=3, octaves=5)
    rgb = flat(stream, size, stream.pick(palettes.LEATHERS), 12)
    return shade(rgb, (1 + 0.1 * worn) * relief(height, 0.35) * (0.86 + 0.28 * height))


def _damask(stream: Stream, size: int, repeats: int) -> Field:
    """Returns an ornament in half drop: mirrored noise, which the eye reads as leaves, in an ogee frame."""
    half = size // (2 * repeats)
    leaves = noise(stream, 10 * repeats, 9 * repeats, size)[: 2 * half, :half]
    leaves = np.concatenate([leaves, leaves[:, ::-1]], axis=1)
    ramp = np.abs(np.arange(2 * half, dtype=np.float32) / half - 1)
    x, y = ramp[None, :], ramp[:, None]  # distance from the middle of the motif, 0 to 1
    bulge = 0.5 + 0.42 * sine(y * 0.5 + 0.25)
    inside = np.clip(2 - 2 * np.maximum(x + 0.6 * y, y) ** 2, 0, 1)
    petals = smoothstep(np.abs(leaves) * inside, 0.14, 0.2) * (x < bulge - 0.06)
    stem = (1 - smoothstep(x, 0.03, 0.07)) * (y < 0.8)
    frame = 1 - smoothstep(np.abs(x - bulge), 0.03, 0.07)
    motif = np.maximum(petals, np.maximum(stem, frame))
    row = np.concatenate([motif] * repeats, axis=1)
    drop = np.roll(row, half, axis=1)
    sheet = np.concatenate([row if i % 2 == 0 else drop for i in range(repeats)], axis=0)
    return _fit(sheet, size)


def _fit(sheet: np.ndarray, size: int) -> Field:
    """Stretches a sheet that is a few pixels short of the texture's side, nearest neighbour."""
    index = np.arange(size) * sheet.shape[0] // size
    return sheet if sheet.shape[0] == size else sheet[index[:, None], index[None, :]]


def _motif(stream: Stream, size: int, kind: str) -> Field:
    """Returns the mask of a wallpaper's print: 1 printed, 0 ground."""
    u, v = coordinates(size)
    count = stream.pick((4, 6, 8))
    if kind == "damask":
        return _damask(stream, size, stream.pick((2, 4)))
    if kind == "stripes":
        return periodic_bands(stream, u, count)
    if kind == "dots":
        pieces = courses(size, 2 * count, count, 0.5)
        x, y = (pieces.along - 0.5) * 2, pieces.across - 0.5
        return 1 - smoothstep(np.sqrt(x * x + y * y), r := stream.uniform(0.15, 0.38), r + 0.06)
    if kind == "trellis":
        wave = 0.5 * sine(v * count) + 0.0
        lines = np.abs(sine((u * count + 0.25 * wave) * 1.0)) * np.abs(sine(u * count - 0.25 * wave))
        return 1 - smoothstep(lines, 0.06, 0.16)
    if kind == "chevron":
        fold = np.abs((u * count) % 1 - 0.5)
        return smoothstep(sine(v * count * 2 + fold), -0.08, 0.08)
    return smoothstep(sine(u * count) * sine(v * count), -0.03, 0.03)  # rounded chequers


def wallpaper(stream: Stream, size: int) -> np.ndarray:
    """Wallpaper: damask, stripes, dots, trellis, chevrons, chequers, or woven texture."""
    kind = stream.pick(
        ("damask", "damask", "stripes", "dots", "trellis", "chevron", "chequers", "grasscloth")
    )
    base = flat(stream, size, stream.pick(palettes.PAINTS), 12)
    paper = 1 + 0.02 * grain(stream, size) + 0.02 * noise(stream, 90, 90, size)
    if kind == "grasscloth":
        fibre = 0.09 * noise(stream, 200, 8, size) + 0.05 * noise(stream, 8, 200, size)
        return shade(base, paper + fibre)
    print_color = base[0, 0] * stream.pick((0.72, 0.84, 0.9, 1.1, 1.2)) + stream.array(-10.0, 10.0, 3)
    if stream.chance(0.3):
        print_color = tinted(stream, stream.pick(palettes.PAINTS), 10)
    return shade(mix(base, np.clip(print_color, 5, 250), _motif(stream, size, kind)), paper)


def linoleum(stream: Stream, size: int) -> np.ndarray:
    """Linoleum and vinyl: two or three tones stretched along the sheet."""
    base = tinted(stream, stream.pick(palettes.TEXTILES + palettes.STONES), 12)
    light, dark = np.clip(base * 1.22 + 8, 0, 250), base * 0.78
    streaks = fractal(stream, size, rows=20, cols=5, octaves=4, gain=0.7)
    flecks = smoothstep(noise(stream, 90, 24, size), 0.6, 1.0)
    rgb = paint(blend([dark, base, light]), 0.5 + 0.3 * streaks)
    return shade(mix(rgb, light, 0.5 * flecks), 1 + 0.02 * grain(stream, size))

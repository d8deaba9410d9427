"""Seamless random fields, bit-identical on every machine.

A texture is named, never stored, so two machines must compute the same bytes from one name. Hence
only operations that IEEE 754 rounds exactly (``+ - * / sqrt``, comparisons, look-ups) act on pixels:
no FFT, no ``sin``, ``exp`` or power of an array, no floating-point reduction, whose last bits depend
on the processor. Random bits come straight from PCG64 and ``SeedSequence``, whose streams NumPy
promises to keep (NEP 19), not from its distributions, whose streams it may change.

A field is float32 of shape (size, size), rows downwards, and wraps round at both edges.
"""

import functools
import math
import zlib
from collections.abc import Callable, Sequence

import numpy as np

Field = np.ndarray  # (size, size) float32

_TABLE = 4096
_SPLINE_STD = 0.277  # of a cubic B-spline through uniform(-1, 1) lattice values


class Stream:
    """A stream of random numbers that depends on its key alone.

    Args:
        key: Integers and strings that name the stream.
    """

    def __init__(self, *key: int | str) -> None:
        words = [zlib.crc32(part.encode()) if isinstance(part, str) else part for part in key]
        self._bits = np.random.PCG64(np.random.SeedSequence(words))

    def array(self, low: float, high: float, *shape: int) -> np.ndarray:
        """Returns float32 numbers, uniform in [low, high)."""
        raw = self._bits.random_raw(math.prod(shape)) >> np.uint64(40)
        unit = raw.astype(np.float32) * np.float32(2.0**-24)
        return (unit * np.float32(high - low) + np.float32(low)).reshape(shape)

    def uniform(self, low: float = 0.0, high: float = 1.0) -> float:
        """Returns one number, uniform in [low, high)."""
        return low + (high - low) * (int(self._bits.random_raw()) >> 11) * 2.0**-53

    def integer(self, low: int, high: int) -> int:
        """Returns an integer in [low, high]."""
        return low + int(self.uniform() * (high - low + 1))

    def chance(self, probability: float) -> bool:
        """Returns True with the given probability."""
        return self.uniform() < probability

    def pick[T](self, options: Sequence[T]) -> T:
        """Returns one of ``options``."""
        return options[self.integer(0, len(options) - 1)]

    def order(self, count: int) -> np.ndarray:
        """Returns a permutation of ``range(count)``."""
        return np.argsort(self._bits.random_raw(count), kind="stable")


@functools.lru_cache(maxsize=16)
def coordinates(size: int) -> tuple[Field, Field]:
    """Returns (u, v): every pixel centre's position across and down, in [0, 1)."""
    line = (np.arange(size, dtype=np.float32) + np.float32(0.5)) / np.float32(size)
    u = np.ascontiguousarray(np.broadcast_to(line, (size, size)))
    return u, np.ascontiguousarray(u.T)


def curve(function: Callable[[float], float]) -> np.ndarray:
    """Tabulates ``function`` over [0, 1), rounded so that every libm gives the same table."""
    values = [round(function(i / _TABLE) * 2**20) / 2**20 for i in range(_TABLE)]
    return np.array(values, dtype=np.float32)


_SINE = curve(lambda x: math.sin(2 * math.pi * x))


def periodic(table: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Looks ``x`` up in a table of one period, [0, 1)."""
    index = np.floor(x * np.float32(len(table))).astype(np.int32) % len(table)
    return np.take(table, index)


def sine(turns: np.ndarray) -> np.ndarray:
    """Returns the sine of an angle given in turns."""
    return periodic(_SINE, turns)


def smoothstep(x: np.ndarray, low: float, high: float) -> np.ndarray:
    """Returns 0 below ``low``, 1 above ``high``, and a smooth cubic between them."""
    t = np.clip((x - np.float32(low)) * np.float32(1.0 / (high - low)), 0.0, 1.0)
    return t * t * (np.float32(3.0) - np.float32(2.0) * t)


@functools.lru_cache(maxsize=256)
def _spline_taps(count: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the indices and weights, both (4, size), of a periodic cubic B-spline."""
    x = (np.arange(size) + 0.5) * count / size - 0.5
    base = np.floor(x)
    t = x - base
    s = 1.0 - t
    weights = (
        np.stack([s * s * s, 4 - 6 * t * t + 3 * t * t * t, 4 - 6 * s * s + 3 * s * s * s, t * t * t]) / 6.0
    )
    index = (base.astype(np.int64) + np.arange(-1, 3)[:, None]) % count
    return index, weights.astype(np.float32)


def _interpolate_rows(lattice: np.ndarray, size: int) -> np.ndarray:
    index, weights = _spline_taps(lattice.shape[0], size)
    out = lattice[index[0]] * weights[0, :, None]
    for tap in range(1, 4):
        out += lattice[index[tap]] * weights[tap, :, None]
    return out


def interpolate(lattice: np.ndarray, size: int) -> Field:
    """Stretches a lattice of any shape over the texture, smoothly and seamlessly."""
    across = _interpolate_rows(np.ascontiguousarray(lattice.T), size)
    return _interpolate_rows(np.ascontiguousarray(across.T), size)


def noise(stream: Stream, rows: int, cols: int, size: int) -> Field:
    """Returns smooth noise with ``rows`` by ``cols`` features; mean 0, standard deviation 0.5."""
    lattice = stream.array(-1.0, 1.0, rows, cols) * np.float32(0.5 / _SPLINE_STD)
    return interpolate(lattice, size)


def grain(stream: Stream, size: int, cells: int = 256) -> Field:
    """Returns unfiltered noise, uniform in [-1, 1), of ``cells`` by ``cells`` squares."""
    lattice = stream.array(-1.0, 1.0, cells, cells)
    index = np.arange(size) * cells // size
    return lattice if size == cells else lattice[index[:, None], index[None, :]]


def fractal(stream: Stream, size: int, *, rows: int, cols: int, octaves: int = 5, gain: float = 0.5) -> Field:
    """Sums noise of doubling frequency; mean 0, standard deviation 0.5.

    Args:
        stream: Source of the lattices.
        size: Pixels along a side.
        rows: Features down the texture in the first octave.
        cols: Features across the texture in the first octave.
        octaves: Number of frequencies, limited to 256 features.
        gain: Amplitude of an octave relative to the one before.
    """
    total = np.zeros((size, size), dtype=np.float32)
    power, amplitude = 0.0, 1.0
    for octave in range(octaves):
        shape = (min(rows << octave, 256), min(cols << octave, 256))
        total += noise(stream, *shape, size) * np.float32(amplitude)
        power += amplitude * amplitude
        amplitude *= gain
    return total * np.float32(1.0 / math.sqrt(power))


def relief(height: Field, strength: float) -> Field:
    """Returns a brightness factor round 1 for a height field lit from the upper left.

    Args:
        height: Height, in any unit.
        strength: Brightness gained per unit of height over 1/256 of the texture.
    """
    slope = np.float32(2.0) * height - np.roll(height, 1, axis=0) - np.roll(height, 1, axis=1)
    scale = np.float32(strength * height.shape[0] / 256.0)
    return np.clip(np.float32(1.0) + slope * scale, 0.4, 1.7)


def cells(
    stream: Stream, size: int, rows: int, cols: int, *, jitter: float = 0.9, stagger: bool = False
) -> tuple[Field, Field, np.ndarray]:
    """Divides the texture into the cells nearest to one random site per lattice square.

    Args:
        stream: Source of the sites.
        size: Pixels along a side.
        rows: Lattice squares down the texture; even when ``stagger``.
        cols: Lattice squares across.
        jitter: 0 puts every site in the middle of its square, 1 anywhere in it.
        stagger: Shift every other row by half a square (with ``jitter=0``: hexagons). Distances are
            then true ones; otherwise they are in squares, so that ``rows > cols`` gives flat cells.

    Returns:
        Distance to the nearest site, distance to the second nearest (both in widths of a lattice
        square), and the nearest site's number, (size, size) int32 in [0, rows * cols).
    """
    u, v = coordinates(size)
    dx = stream.array(-0.5, 0.5, rows, cols) * jitter + 0.5
    dy = stream.array(-0.5, 0.5, rows, cols) * jitter + 0.5
    if stagger:
        dx[1::2] += 0.5
    aspect = cols / rows if stagger else 1.0
    x, y = u[0] * cols, v[:, 0] * rows
    col, row = np.floor(x).astype(np.int32), np.floor(y).astype(np.int32)
    number = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    first = np.full((size, size), 1e9, dtype=np.float32)
    second = first.copy()
    nearest = np.zeros((size, size), dtype=np.int32)
    for j in (-2, -1, 0, 1) if stagger else (-1, 0, 1):
        c = (col + j) % cols
        gap_x = dx[:, c] + (col + np.float32(j) - x)  # (rows, size), as are the next two
        square_x, dy_c, number_c = gap_x * gap_x, dy[:, c], number[:, c]
        for i in (-1, 0, 1):
            r = (row + i) % rows
            gap_y = (dy_c[r] + (row + np.float32(i) - y)[:, None]) * aspect
            distance = np.multiply(gap_y, gap_y, out=gap_y)
            distance += square_x[r]
            np.copyto(nearest, number_c[r], where=distance < first)
            np.minimum(second, np.maximum(first, distance), out=second)
            np.minimum(first, distance, out=first)
    return np.sqrt(first), np.sqrt(second), nearest

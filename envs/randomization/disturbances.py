"""What a camera does to an image: exposure and gamma, blur, noise, JPEG; one implementation for all devices.

In this order: exposure and gamma map each of the 256 values; a blur by a Gaussian or along a line; noise of
the variance ``gaussian_noise² + shot_noise² · brightness`` (the Poissonian-Gaussian model of Foi et al. 2008,
doi:10.1109/TIP.2008.2001399); quantization of JPEG's coefficients by the tables of its standard (ITU-T T.81,
Annex K), scaled by quality as libjpeg does, with chroma at half the resolution.

Every number follows from tables, sums and products of single values, never from a reduction whose order a
library chooses. So an image is bit-identical whatever else is in its batch, and on every device that rounds
as IEEE 754 says. Images of NumPy are tensors on the CPU that share their memory.

Shapes: n images, H × W pixels, 3 colours.
"""

import functools
import math
import zlib
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from envs.scenario import SensorCfg

NOISE_SIZE = 1 << 20
"""Numbers of the table of noise: an image reads it from a place of its own on, and starts over at its end."""

DISPLAY_GAMMA = 2.2
"""Exponent of the encoding of images: light doubles where a value grows by 2 ** (1 / 2.2)."""

AT_ONCE = 256
"""Images that are disturbed together on a device; on a CPU one by one, which stay in its cache."""

_LUMA_TABLE = (
    *(16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55),
    *(14, 13, 16, 24, 40, 57, 69, 56, 14, 17, 22, 29, 51, 87, 80, 62),
    *(18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92),
    *(49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99),
)
_CHROMA_TABLE = (
    *(17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99),
    *(24, 26, 56, 99, 99, 99, 99, 99, 47, 66, 99, 99, 99, 99, 99, 99),
    *((99,) * 32),
)

type Shifts = Mapping[tuple[int, int], float]
"""Weight of the pixel so many rows below and columns to the right."""


def disturb_arrays(
    images: np.ndarray, sensors: Sequence[SensorCfg], frames: Sequence[int], camera: str
) -> np.ndarray:
    """Returns disturbed images of NumPy; see :func:`disturb`."""
    if not any(sensor.disturbs for sensor in sensors):
        return images
    return disturb(torch.from_numpy(np.ascontiguousarray(images)), sensors, frames, camera).numpy()


@torch.no_grad()
def disturb(images: Tensor, sensors: Sequence[SensorCfg], frames: Sequence[int], camera: str) -> Tensor:
    """Returns what cameras make of rendered images.

    Args:
        images: (n, H, W, 3) uint8, on any device.
        sensors: What is done to each.
        frames: Number of each image in its episode, which chooses its noise.
        camera: Name of the camera, which does too.

    Returns:
        (n, H, W, 3) uint8 on the same device; ``images`` stay as they are.
    """
    rows = [row for row, sensor in enumerate(sensors) if sensor.disturbs]
    if not rows or not images.numel():
        return images
    out = images.clone()
    size = 1 if images.device.type == "cpu" else AT_ONCE
    for first in range(0, len(rows), size):
        part = rows[first : first + size]
        chosen = [sensors[row] for row in part]
        index = torch.tensor(part, device=images.device)
        starts = [noise_start(s.noise_seed, frames[row], camera) for s, row in zip(chosen, part, strict=True)]
        out[index] = _disturbed(images[index], chosen, starts)
    return out


def noise_start(seed: int, frame: int, camera: str) -> int:
    """Returns where an image's noise begins in the table."""
    key = (zlib.crc32(camera.encode()), int(frame))
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1)[0]) % NOISE_SIZE


def _disturbed(images: Tensor, sensors: Sequence[SensorCfg], starts: Sequence[int]) -> Tensor:
    values = _toned(images, sensors)
    height = images.shape[1]
    shifts = [_line(s.motion_length * height, s.motion_angle_rad) for s in sensors]
    values = _blurred(values, shifts)
    tails = [_gaussian(s.blur_sigma * height) for s in sensors]
    values = _blurred(values, [{(at, 0): weight for at, weight in tail.items()} for tail in tails])
    values = _blurred(values, [{(0, at): weight for at, weight in tail.items()} for tail in tails])
    values = _noisy(values, sensors, starts)
    values = values.clamp(0.0, 255.0).round()
    packed = [row for row, sensor in enumerate(sensors) if sensor.jpeg_quality]
    if packed:
        index = torch.tensor(packed, device=values.device)
        values[index] = jpeg(values[index], [sensors[row].jpeg_quality for row in packed])
    return values.to(torch.uint8)


def _toned(images: Tensor, sensors: Sequence[SensorCfg]) -> Tensor:
    """Returns the images after exposure and gamma, float32."""
    curves = torch.from_numpy(np.stack([tone_curve(s.exposure_ev, s.gamma) for s in sensors]))
    flat = curves.to(images.device).flatten()
    first = 256 * torch.arange(len(images), device=images.device).view(-1, 1, 1, 1)
    return flat[first + images.long()]


def tone_curve(exposure_ev: float, gamma: float) -> np.ndarray:
    """Returns what becomes of each of the values 0 to 255, (256,) float32."""
    share = np.linspace(0.0, 1.0, 256) * 2.0 ** (exposure_ev / DISPLAY_GAMMA)
    return (255.0 * np.clip(share, 0.0, 1.0) ** gamma).astype(np.float32)


def _gaussian(sigma: float) -> dict[int, float]:
    """Returns the weights of a Gaussian by pixel, up to three standard deviations; none where it is 0."""
    if sigma <= 0:
        return {}
    reach = max(1, math.ceil(3.0 * sigma))
    weights = {at: math.exp(-0.5 * (at / sigma) ** 2) for at in range(-reach, reach + 1)}
    total = math.fsum(weights.values())
    return {at: weight / total for at, weight in weights.items()}


def _line(length: float, angle_rad: float) -> dict[tuple[int, int], float]:
    """Returns the weights of a straight line through the pixel, which is so many pixels long."""
    if length <= 0:
        return {}
    count = 2 * math.ceil(length) + 1
    weights: dict[tuple[int, int], float] = {}
    for step in range(count):
        way = length * (step / (count - 1) - 0.5)
        y, x = way * math.sin(angle_rad), way * math.cos(angle_rad)
        low_y, low_x = math.floor(y), math.floor(x)
        for dy, share_y in ((0, 1.0 - (y - low_y)), (1, y - low_y)):
            for dx, share_x in ((0, 1.0 - (x - low_x)), (1, x - low_x)):
                if share_y * share_x > 0:
                    at = (low_y + dy, low_x + dx)
                    weights[at] = weights.get(at, 0.0) + share_y * share_x / count
    return weights


def _blurred(values: Tensor, shifts: Sequence[Shifts]) -> Tensor:
    """Returns weighted sums of shifted images; past its border an image continues with its last pixels."""
    rows = [row for row, weights in enumerate(shifts) if weights]
    if not rows:
        return values
    places = sorted({place for row in rows for place in shifts[row]})
    reach = max(max(abs(dy), abs(dx)) for dy, dx in places)
    index = torch.tensor(rows, device=values.device)
    height, width = values.shape[1:3]
    at_y, at_x = (
        torch.arange(-reach, size + reach, device=values.device).clamp(0, size - 1)
        for size in (height, width)
    )
    padded = values[index][:, at_y][:, :, at_x]
    table = torch.tensor([[shifts[row].get(place, 0.0) for row in rows] for place in places])
    table = table.to(device=values.device, dtype=values.dtype)
    total = torch.zeros_like(values[index])
    for (dy, dx), weights in zip(places, table, strict=True):
        y, x = reach + dy, reach + dx
        total += padded[:, y : y + height, x : x + width] * weights.view(-1, 1, 1, 1)
    out = values.clone()
    out[index] = total
    return out


@functools.cache
def _noise(device: torch.device) -> Tensor:
    """Returns the table of noise, (NOISE_SIZE,) float32: normal numbers, the same on every machine."""
    numbers = np.random.default_rng(np.random.SeedSequence(0)).standard_normal(NOISE_SIZE, np.float32)
    return torch.from_numpy(numbers).to(device)


def _noisy(values: Tensor, sensors: Sequence[SensorCfg], starts: Sequence[int]) -> Tensor:
    if not any(s.gaussian_noise or s.shot_noise for s in sensors):
        return values
    device, size = values.device, values[0].numel()
    first = torch.tensor(starts, device=device)[:, None]
    noise = _noise(device)[(first + torch.arange(size, device=device)) % NOISE_SIZE].view(values.shape)

    def column(numbers: list[float]) -> Tensor:
        return torch.tensor(numbers, device=device, dtype=values.dtype).view(-1, 1, 1, 1)

    fixed = column([(255.0 * s.gaussian_noise) ** 2 for s in sensors])
    growing = column([255.0 * s.shot_noise**2 for s in sensors])
    return values + noise * (fixed + growing * values.clamp(min=0.0)).sqrt()


def quantization(quality: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns JPEG's quantization tables at a quality from 1 to 100: luma and chroma, (8, 8) float32."""
    scale = 5000 // quality if quality < 50 else 200 - 2 * quality
    tables = (np.clip((np.array(t) * scale + 50) // 100, 1, 255) for t in (_LUMA_TABLE, _CHROMA_TABLE))
    luma, chroma = (table.reshape(8, 8).astype(np.float32) for table in tables)
    return luma, chroma


def _cosines() -> np.ndarray:
    """Returns the orthonormal cosine transform of 8 values, (8, 8) float32."""
    k, j = np.mgrid[:8, :8]
    matrix = np.cos((2 * j + 1) * k * np.pi / 16) / 2.0
    matrix[0] /= math.sqrt(2.0)
    return matrix.astype(np.float32)


def jpeg(values: Tensor, qualities: Sequence[int]) -> Tensor:
    """Returns what JPEG keeps of images.

    Args:
        values: Whole numbers, (n, H, W, 3), 0 to 255, float32.
        qualities: Quality of each, 1 to 100.
    """
    device, (height, width) = values.device, values.shape[1:3]
    at_y, at_x = (
        torch.arange(math.ceil(size / 16) * 16, device=device).clamp(max=size - 1) for size in (height, width)
    )
    red, green, blue = values[:, at_y][:, :, at_x].unbind(-1)
    tables = [quantization(quality) for quality in qualities]
    luma_table, chroma_table = (
        torch.from_numpy(np.stack(part)).to(device) for part in zip(*tables, strict=True)
    )
    # ITU-R BT.601, full range, as JFIF has it; the chroma is centred on 0.
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    kept_luma = _quantized(luma - 128.0, luma_table) + 128.0
    of_blue, of_red = (
        _doubled(_quantized(_halved((colour - luma) * scale), chroma_table))
        for colour, scale in ((blue, 0.5 / (1.0 - 0.114)), (red, 0.5 / (1.0 - 0.299)))
    )
    red = kept_luma + 1.402 * of_red
    blue = kept_luma + 1.772 * of_blue
    green = kept_luma - (0.114 * 1.772 / 0.587) * of_blue - (0.299 * 1.402 / 0.587) * of_red
    return torch.stack([red, green, blue], -1)[:, :height, :width].clamp(0.0, 255.0).round()


def _halved(plane: Tensor) -> Tensor:
    """Returns the means of squares of two by two pixels."""
    rows = plane[:, ::2] + plane[:, 1::2]
    return 0.25 * (rows[..., ::2] + rows[..., 1::2])


def _doubled(plane: Tensor) -> Tensor:
    """Returns planes of twice the size, interpolated as libjpeg does: three quarters of the nearest value."""
    for axis in (1, 2):
        size = plane.shape[axis]
        at = torch.arange(size, device=plane.device)
        before = plane.index_select(axis, (at - 1).clamp(min=0))
        after = plane.index_select(axis, (at + 1).clamp(max=size - 1))
        pair = torch.stack([0.75 * plane + 0.25 * before, 0.75 * plane + 0.25 * after], axis + 1)
        plane = pair.flatten(axis, axis + 1)
    return plane


def _quantized(plane: Tensor, table: Tensor) -> Tensor:
    """Returns planes (n, H, W) whose blocks' coefficients are multiples of ``table`` (n, 8, 8)."""
    cosines = torch.from_numpy(_cosines()).to(plane.device)
    count, height, width = plane.shape
    blocks = plane.reshape(count, height // 8, 8, width // 8, 8)
    steps = table.view(count, 1, 8, 1, 8)
    kept = (_along(_along(blocks, cosines, 2), cosines, 4) / steps).round() * steps
    return _along(_along(kept, cosines.T, 2), cosines.T, 4).reshape(count, height, width)


def _along(blocks: Tensor, matrix: Tensor, axis: int) -> Tensor:
    """Multiplies the vectors along an axis of length 8 by a matrix, term by term in a fixed order."""
    shape = [1] * blocks.ndim
    shape[axis] = 8
    total = torch.zeros_like(blocks)
    for j in range(8):
        total += blocks.narrow(axis, j, 1) * matrix[:, j].view(shape)
    return total

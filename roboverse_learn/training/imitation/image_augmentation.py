"""Random changes of images, drawn per sample on the device that holds them.

Randomness is torch's global generator, which the training loop seeds at every step.

Shapes: B samples, T observations in time, C=3 channels, H, W pixels.
"""

import math
from collections.abc import Callable, Mapping
from functools import cache

import torch
from torch import Tensor
from torch.nn import functional

from envs.core.observation_keys import IMAGE_PREFIX
from roboverse_learn.data.dataset.on_device import constant
from roboverse_learn.training.config import AugmentConfig


def augment_cameras(images: Mapping[str, Tensor], config: AugmentConfig) -> dict[str, Tensor]:
    """Returns the augmented images of a batch by the keys of their features; see :func:`augment`."""
    return {key: augment(each, config, key.removeprefix(IMAGE_PREFIX)) for key, each in images.items()}


def augment(images: Tensor, config: AugmentConfig, camera: str = "") -> Tensor:
    """Swaps, shifts and recolours images; all observations of a sample alike.

    Args:
        images: (B, [T,] C, H, W) uint8.
        config: What is changed, and how far.
        camera: Whose images they are.

    Returns:
        The same shape; uint8 if the colours are unchanged, else float32 from 0 to 1.
    """
    if config.swap and camera == config.swap_camera:
        images = _swapped(images, config.swap)
    if config.shift_px:
        images = shift(images, _offsets(len(images), config.shift_px, images.device))
    if not config.recolours:
        return images
    images = images.float().div_(255.0)
    if config.convolution:
        images = _convolved(images, config.convolution)
    if config.overlay:
        images = torch.lerp(images, _smooth_colours(images), config.overlay * _per_sample(images, torch.rand))
    if config.tone:
        images = _toned(images, config.tone)
    if config.shadow:
        images = _shadowed(images, config.shadow)
    return _recoloured(images, config).clamp_(0.0, 1.0)


def shift(images: Tensor, offsets: Tensor) -> Tensor:
    """Moves images by whole pixels and repeats the border.

    Args:
        images: (B, [T,] C, H, W).
        offsets: (B, 2) integers: the row and column of the source that becomes the upper left.

    Returns:
        The same shape and type.
    """
    height, width = images.shape[-2:]
    rows = (torch.arange(height, device=images.device) + offsets[:, :1]).clamp_(0, height - 1)  # (B, H)
    columns = (torch.arange(width, device=images.device) + offsets[:, 1:]).clamp_(0, width - 1)  # (B, W)
    sources = rows[:, :, None] * width + columns[:, None, :]  # (B, H, W)
    pixels = images.flatten(-2)
    sources = sources.reshape(len(images), *[1] * (images.ndim - 3), height * width).expand_as(pixels)
    return pixels.gather(-1, sources).view_as(images)


def _offsets(num: int, largest: int, device: torch.device) -> Tensor:
    return torch.randint(-largest, largest + 1, (num, 2), device=device)


def _per_sample(images: Tensor, draw: Callable[..., Tensor]) -> Tensor:
    """Draws a number for each sample, in the shape (B, 1, ...) of its images."""
    return draw([len(images)] + [1] * (images.ndim - 1), device=images.device)


def _swapped(images: Tensor, share: float) -> Tensor:
    """Gives a share of the samples the images of others."""
    others = images[torch.randperm(len(images), device=images.device)]
    return torch.where(_per_sample(images, torch.rand) < share, others, images)


def _convolved(images: Tensor, share: float) -> Tensor:
    """Mixes a share of the samples with their convolution by a random filter, at the same mean and spread."""
    frames = images.reshape(len(images), -1, *images.shape[-3:])  # (B, T, C, H, W)
    filters = torch.randn(len(images), 1, 3, 27, device=images.device)
    padded = functional.pad(frames.flatten(0, 1), (1, 1, 1, 1), mode="replicate")
    patches = functional.unfold(padded, 3).reshape(*frames.shape[:2], 27, -1)
    found = (filters @ patches).reshape(images.shape)
    over = (-3, -2, -1)
    std, mean = torch.std_mean(images, over, keepdim=True)
    its_std, its_mean = torch.std_mean(found, over, keepdim=True)
    found = (found - its_mean) * (std / its_std.clamp(min=1e-6)) + mean
    weight = _per_sample(images, torch.rand) * (_per_sample(images, torch.rand) < share)
    return torch.lerp(images, found, weight)


def _smooth_colours(images: Tensor) -> Tensor:
    """Returns random colours (B, [1,] C, H, W) from 0 to 1 that change smoothly, in large and small spots."""
    total = images.new_zeros(())
    for spots in (4, 16):
        drawn = torch.rand(len(images), 3, spots, spots, device=images.device)
        total = total + functional.interpolate(drawn, images.shape[-2:], mode="bilinear")
    return (total / 2.0).reshape(len(images), *[1] * (images.ndim - 4), *images.shape[-3:])


_KNOTS = 6
"""Values of a random curve of luma, between which it is linear; beyond them it falls to 0."""


def _toned(images: Tensor, share: float) -> Tensor:
    """Moves the luma of a share of the samples along a random curve; chroma stays."""
    luma = _grey(images)
    heights = torch.rand([_KNOTS, len(images)] + [1] * (images.ndim - 1), device=images.device)
    curves = functional.pad(heights.reshape(_KNOTS, -1).T, (1, 1))  # (B, knots), 0 at both ends
    place = (luma.flatten(1) * (_KNOTS - 1) + 1.0).clamp_(0.0, _KNOTS + 1.0)
    knot = place.long().clamp_(max=_KNOTS)
    moved = torch.lerp(curves.gather(1, knot), curves.gather(1, knot + 1), place - knot).view_as(luma)
    return (images + (moved - luma) * (_per_sample(images, torch.rand) < share)).clamp_(0.0, 1.0)


def _shadowed(images: Tensor, share: float) -> Tensor:
    """Darkens random spots with soft edges in a share of the samples, each by a factor of its own."""
    drawn = torch.rand(len(images), 1, 6, 6, device=images.device)
    spots = functional.interpolate(drawn, images.shape[-2:], mode="bilinear")
    spots = (
        ((spots - 0.6) * 12.0)
        .clamp_(0.0, 1.0)
        .reshape(len(images), *[1] * (images.ndim - 3), *images.shape[-2:])
    )
    depth = 0.9 * _per_sample(images, torch.rand) * (_per_sample(images, torch.rand) < share)
    return images * (1.0 - depth * spots)


_IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

_LUMA = (0.299, 0.587, 0.114)
"""Of red, green and blue, by ITU-R BT.601."""

_TO_YIQ = (_LUMA, (0.5959, -0.2746, -0.3213), (0.2115, -0.5227, 0.3112))
"""Luma and chroma of NTSC, whose chroma plane a hue is an angle in."""


def _recoloured(images: Tensor, config: AugmentConfig) -> Tensor:
    """Changes brightness, contrast, saturation and hue of each sample, in this order.

    All are affine in a pixel's colours, so that they are one matrix and one grey for each image.
    """
    if not any((config.brightness, config.contrast, config.saturation, config.hue)):
        return images
    frames = images.reshape(len(images), -1, 3, images.shape[-2] * images.shape[-1])
    brightness, contrast, saturation = (
        _factor(frames, strength) for strength in (config.brightness, config.contrast, config.saturation)
    )
    scale, grey = brightness * contrast, 0.0
    if config.contrast:
        grey = brightness * (1.0 - contrast) * _grey(images).reshape(*frames.shape[:2], 1, -1).mean(-1, True)
    if not (config.saturation or config.hue):
        return (frames * scale + grey).view_as(images)
    matrix = constant(_IDENTITY, torch.float32, images.device)
    if config.saturation:
        matrix = torch.lerp(constant((_LUMA,) * 3, torch.float32, images.device), matrix, saturation)
    if config.hue:
        matrix = _turned_hues(len(images), config.hue, images.device) @ matrix
    changed = (scale * matrix) @ frames
    return changed.add_(matrix.sum(-1, keepdim=True) * grey).view_as(images)


def _factor(frames: Tensor, strength: float) -> Tensor | float:
    """Draws a factor within ``1 ± strength`` for each sample, (B, 1, 1, 1); 1 without a strength."""
    return 1.0 + strength * (2.0 * _per_sample(frames, torch.rand) - 1.0) if strength else 1.0


def _turned_hues(num: int, largest: float, device: torch.device) -> Tensor:
    """Returns matrices (B, 1, 3, 3) that turn the hue of colours by at most ``largest`` of a turn."""
    angle = 2.0 * math.pi * largest * (2.0 * torch.rand(num, device=device) - 1.0)
    turn = torch.eye(3, device=device).repeat(num, 1, 1, 1)
    turn[:, 0, 1, 1] = turn[:, 0, 2, 2] = torch.cos(angle)
    turn[:, 0, 2, 1] = torch.sin(angle)
    turn[:, 0, 1, 2] = -turn[:, 0, 2, 1]
    return constant(_from_yiq(), torch.float32, device) @ turn @ constant(_TO_YIQ, torch.float32, device)


@cache
def _from_yiq() -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, torch.linalg.inv(torch.tensor(_TO_YIQ, dtype=torch.float64)).tolist()))


def _grey(images: Tensor) -> Tensor:
    """Luma (B, [T,] 1, H, W)."""
    return (images * constant(_LUMA, torch.float32, images.device).reshape(3, 1, 1)).sum(dim=-3, keepdim=True)

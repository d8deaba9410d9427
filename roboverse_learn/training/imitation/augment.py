"""Random changes of images, drawn per sample on the device that holds them.

Randomness is torch's global generator, which the training loop seeds at every step.

Shapes: B samples, T observations in time, C=3 channels, H, W pixels.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from roboverse_learn.training.config import AugmentConfig


def augment(images: Tensor, config: AugmentConfig) -> Tensor:
    """Shifts and recolours images; all observations of a sample alike.

    Args:
        images: (B, [T,] C, H, W) uint8.
        config: What is changed, and how far.

    Returns:
        The same shape; uint8 if the colours are unchanged, else float32 from 0 to 1.
    """
    if config.shift_px:
        images = shift(images, _offsets(len(images), config.shift_px, images.device))
    if not (config.brightness or config.contrast or config.saturation):
        return images
    images = images.float().div_(255.0)
    # Brightness leaves the grey of an image to the two after it, so the order is fixed.
    images = _blend(images, config.brightness, torch.zeros_like)
    images = _blend(images, config.contrast, lambda x: _grey(x).mean(dim=(-1, -2), keepdim=True))
    images = _blend(images, config.saturation, _grey)
    return images.clamp_(0.0, 1.0)


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
    shape = [len(images)] + [1] * (images.ndim - 3)
    rows = rows.reshape(*shape, height, 1).expand_as(images)
    columns = columns.reshape(*shape, 1, width).expand_as(images)
    return images.gather(-2, rows).gather(-1, columns)


def _offsets(num: int, largest: int, device: torch.device) -> Tensor:
    return torch.randint(-largest, largest + 1, (num, 2), device=device)


def _blend(images: Tensor, strength: float, other: Callable[[Tensor], Tensor]) -> Tensor:
    """Moves each sample away from or towards ``other``, by a factor within ``1 ± strength``."""
    if not strength:
        return images
    shape = [len(images)] + [1] * (images.ndim - 1)
    factor = 1.0 + strength * (2.0 * torch.rand(shape, device=images.device) - 1.0)
    return torch.lerp(other(images).expand_as(images), images, factor)


def _grey(images: Tensor) -> Tensor:
    """Luma (B, [T,] 1, H, W) by ITU-R BT.601."""
    weights = torch.tensor([0.299, 0.587, 0.114], device=images.device).reshape(3, 1, 1)
    return (images * weights).sum(dim=-3, keepdim=True)

"""Images and numbers of one observation as one row of bytes: one tensor, a byte a pixel, nothing rounded.

Libraries of reinforcement learning keep one tensor per step, of one type. Images as floats would take four
times the memory, and numbers as bytes their precision.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor


def row_size(image_shape: Sequence[int], num_numbers: int) -> int:
    """Returns the bytes of a row with an image (C, H, W) and so many numbers."""
    return math.prod(image_shape) + 4 * num_numbers


def pack(images: Tensor, numbers: Tensor) -> Tensor:
    """Returns images (…, C, H, W) uint8 and numbers (…, S) as rows of bytes (…, C H W + 4 S)."""
    return torch.cat((images.flatten(-3), numbers.float().contiguous().view(torch.uint8)), dim=-1)


def unpack(rows: Tensor, image_shape: Sequence[int]) -> tuple[Tensor, Tensor]:
    """Returns what :func:`pack` made rows of: images (…, C, H, W) uint8 and numbers (…, S) float32."""
    size = math.prod(image_shape)
    images, given = rows[..., :size].unflatten(-1, tuple(image_shape)), rows[..., size:]
    # Floats begin at any byte of a row, and a clone of a view with gaps can keep its strides.
    aligned = torch.empty(given.shape, dtype=torch.uint8, device=rows.device).copy_(given)
    return images, aligned.view(torch.float32)

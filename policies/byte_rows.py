"""Images and numbers of one observation as one row of bytes: one tensor, a byte a pixel, nothing rounded.

Libraries of reinforcement learning keep one tensor per step, of one type. Images as floats would take four
times the memory, and numbers as bytes their precision. Tensors are torch's, by their own methods: nothing is
imported here.
"""

import math
from collections.abc import Sequence
from typing import Any


def row_size(image_shape: Sequence[int], num_numbers: int) -> int:
    """Returns the bytes of a row with an image (C, H, W) and so many numbers."""
    return math.prod(image_shape) + 4 * num_numbers


def pack(images: Any, numbers: Any) -> Any:
    """Returns images (…, C, H, W) uint8 and numbers (…, S) as rows of bytes (…, C H W + 4 S)."""
    pixels = images.flatten(-3)
    size = pixels.shape[-1]
    rows = pixels.new_empty((*pixels.shape[:-1], size + 4 * numbers.shape[-1]))
    rows[..., :size] = pixels
    rows[..., size:] = numbers.float().contiguous().view(pixels.dtype)
    return rows


def unpack(rows: Any, image_shape: Sequence[int]) -> tuple[Any, Any]:
    """Returns what :func:`pack` made rows of: images (…, C, H, W) uint8 and numbers (…, S) float32."""
    size = math.prod(image_shape)
    images, given = rows[..., :size].unflatten(-1, tuple(image_shape)), rows[..., size:]
    aligned = given.new_empty(given.shape).copy_(given)  # floats begin at any byte of a row
    return images, aligned.view(given.new_empty(0).float().dtype)

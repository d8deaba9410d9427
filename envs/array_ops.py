"""Functions that take numpy arrays or torch tensors, for rewards and success of a few environments.

A step of one environment evaluates about forty operations. On small arrays numpy is 3× faster than torch.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

Array = Any  # numpy.ndarray or torch.Tensor


def norm(vectors: Array) -> Array:
    """Returns the Euclidean lengths (...,) of vectors (..., D)."""
    if isinstance(vectors, np.ndarray):
        return np.sqrt(np.vecdot(vectors, vectors))
    import torch

    return torch.linalg.vector_norm(vectors, dim=-1)


def tanh(values: Array) -> Array:
    """Returns the hyperbolic tangent of each value."""
    return np.tanh(values) if isinstance(values, np.ndarray) else values.tanh()


def largest(values: Array) -> Array:
    """Returns the maximum over the last axis."""
    return np.maximum.reduce(values, -1) if isinstance(values, np.ndarray) else values.amax(-1)


def at_least(values: Array, least: float) -> Array:
    """Returns the values, clipped from below at ``least``."""
    return np.maximum(values, least) if isinstance(values, np.ndarray) else values.clamp(min=least)


def stack(parts: Sequence[Array]) -> Array:
    """Returns arrays of one shape as one, along a new first axis."""
    if isinstance(parts[0], np.ndarray):
        return np.array(parts)
    import torch

    return torch.stack(tuple(parts))


def concatenate(parts: Sequence[Array]) -> Array:
    """Returns arrays as one, along their last axis."""
    if isinstance(parts[0], np.ndarray):
        return np.concatenate(parts, axis=-1)
    import torch

    return torch.cat(tuple(parts), dim=-1)


def filled(values: Array, where: Array, value: float) -> Array:
    """Returns the values, with ``value`` where the mask ``where`` is true."""
    if isinstance(values, np.ndarray):
        return np.where(where, value, values)
    return values.masked_fill(where, value)  # 3× faster than torch.where


def where(mask: Array, yes: Array, no: Array) -> Array:
    """Returns ``yes`` where the mask is true, and ``no`` elsewhere; either may be a number."""
    if isinstance(mask, np.ndarray):
        return np.where(mask, yes, no)
    import torch

    return torch.where(mask, yes, no)


def constant(values: Sequence[float], like: Array) -> Array:
    """Returns numbers as an array of the kind, precision and device of ``like``."""
    if isinstance(like, np.ndarray):
        return np.asarray(values, like.dtype)
    return like.new_tensor(tuple(values))


def within(values: Array, least: float, most: float) -> Array:
    """Returns the values, clipped to ``least`` and ``most``."""
    if isinstance(values, np.ndarray):
        return np.minimum(np.maximum(values, least), most)
    return values.clamp(least, most)


def to_numpy(values: Array) -> np.ndarray:
    """Returns a numpy array, copied from the device if necessary."""
    return values if isinstance(values, np.ndarray) else values.cpu().numpy()

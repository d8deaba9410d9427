"""Functions of numpy arrays and of torch tensors alike, for what judges the states of a few environments.

One environment is judged by some forty operations in every step. On a handful of numbers, one of numpy takes
a third of the time of one of torch.
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
    """Returns the largest of the last axis."""
    return np.maximum.reduce(values, -1) if isinstance(values, np.ndarray) else values.amax(-1)


def at_least(values: Array, least: float) -> Array:
    """Returns the values, and ``least`` for those below it."""
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
    """Returns the values, and ``value`` at those that ``where`` says."""
    if isinstance(values, np.ndarray):
        return np.where(where, value, values)
    return values.masked_fill(where, value)  # a third of the time of torch.where


def to_numpy(values: Array) -> np.ndarray:
    """Returns an array as numpy's, wherever it is."""
    return values if isinstance(values, np.ndarray) else values.cpu().numpy()

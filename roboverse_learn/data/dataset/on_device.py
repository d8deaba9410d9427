"""Small tensors to a device. A plain copy to a GPU waits until the GPU has done all that it was given."""

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import torch


@cache
def constant(values: "tuple[Any, ...]", dtype: "torch.dtype", device: "torch.device") -> "torch.Tensor":
    """Returns numbers as a tensor on a device, copied there once. It must not be changed."""
    import torch

    return torch.tensor(values, dtype=dtype, device=device)


def all_sent(arrays: Sequence[np.ndarray], device: "torch.device") -> "list[torch.Tensor]":
    """Returns arrays of int64 on a device, by one copy, for which the host does not wait."""
    import torch

    if device.type != "cuda":
        return [torch.from_numpy(array).to(device) for array in arrays]
    numbers = torch.empty(sum(array.size for array in arrays), dtype=torch.int64, pin_memory=True)
    np.concatenate([array.reshape(-1) for array in arrays], out=numbers.numpy())
    pieces = numbers.to(device, non_blocking=True).split([array.size for array in arrays])
    return [piece.view(array.shape) for piece, array in zip(pieces, arrays, strict=True)]


def taken(
    tensor: "torch.Tensor", rows: np.ndarray, sent_rows: "torch.Tensor", device: "torch.device"
) -> "torch.Tensor":
    """Returns rows of a tensor that lies on a device or in main memory, on the device.

    Args:
        tensor: (N, ...).
        rows: Which, of any shape, from 0 to N - 1.
        sent_rows: The same on the device.
        device: Where they are wanted.
    """
    import torch

    shape = (*rows.shape, *tensor.shape[1:])
    if tensor.device.type != "cpu":
        return tensor.index_select(0, sent_rows.reshape(-1)).view(shape)
    # By one thread, as fast as torch's by two: those wait for each other where cores are busy. Into memory
    # from which a copy to a GPU does not wait for it.
    values = torch.empty(shape, dtype=tensor.dtype, pin_memory=device.type == "cuda")
    into = values.numpy().reshape(rows.size, *tensor.shape[1:])
    tensor.numpy().take(rows.reshape(-1), axis=0, out=into, mode="clip")  # "raise" writes to a copy first
    return values.to(device, non_blocking=True)

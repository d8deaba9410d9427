"""Small tensors to a device. A plain copy to a GPU waits until the GPU has done all that it was given."""

from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import torch


@cache
def constant(values: "tuple[Any, ...]", dtype: "torch.dtype", device: "torch.device") -> "torch.Tensor":
    """Returns numbers as a tensor on a device, copied there once. It must not be changed."""
    import torch

    return torch.tensor(values, dtype=dtype, device=device)


def sent(tensor: "torch.Tensor", device: "torch.device") -> "torch.Tensor":
    """Returns a tensor of the host on a device, where what follows finds it; the host goes on at once."""
    if device.type != "cuda" or tensor.device.type != "cpu":
        return tensor.to(device)
    return tensor.pin_memory().to(device, non_blocking=True)

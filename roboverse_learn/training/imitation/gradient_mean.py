"""One policy in several processes: all begin with the weights of the first and step by the mean gradient.

PyTorch's DistributedDataParallel wraps the network, which neither a compiled loss nor one that is played back
from CUDA graphs allows. Here each process computes its gradients in whichever form is fastest, and they are
averaged afterwards, in one message.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn


@torch.no_grad()
def share_weights(model: nn.Module) -> None:
    """Copies the parameters and buffers of the first process to all others."""
    for tensor in (*model.parameters(), *model.buffers()):
        torch.distributed.broadcast(tensor.data, src=0)


@torch.no_grad()
def average_gradients(parameters: Sequence[nn.Parameter], num_processes: int) -> None:
    """Replaces each gradient by its mean over the processes.

    Args:
        parameters: In the same order in each process. Those without a gradient have none in any process.
        num_processes: How many take part.
    """
    gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
    for dtype in dict.fromkeys(gradient.dtype for gradient in gradients):
        _average([gradient for gradient in gradients if gradient.dtype == dtype], num_processes)


def _average(tensors: list[Tensor], num_processes: int) -> None:
    """Averages tensors of one type in place."""
    flat = torch.cat([tensor.flatten() for tensor in tensors])
    torch.distributed.all_reduce(flat)
    flat /= num_processes
    parts = flat.split([tensor.numel() for tensor in tensors])
    means = [part.view_as(x) for part, x in zip(parts, tensors, strict=True)]
    torch._foreach_copy_(tensors, means)  # pyright: ignore[reportPrivateImportUsage]

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
    trained = [parameter for parameter in parameters if parameter.grad is not None]
    for dtype in dict.fromkeys(parameter.dtype for parameter in trained):
        _average(
            [_in_memory_order(parameter) for parameter in trained if parameter.dtype == dtype], num_processes
        )


def _in_memory_order(parameter: nn.Parameter) -> Tensor:
    """Returns a parameter's gradient as a vector (N,) that shares its memory.

    The order is that of the parameter's memory, which all processes share; that of a gradient need not be. A
    vector in the order of its indices would copy each gradient of a network in channels-last memory.
    """
    gradient = parameter.grad
    assert gradient is not None
    if gradient.stride() != parameter.stride():
        gradient = parameter.grad = torch.empty_like(parameter).copy_(gradient)
    return gradient.as_strided((gradient.numel(),), (1,))


def _average(vectors: list[Tensor], num_processes: int) -> None:
    """Averages vectors (N,) of one type in place."""
    flat = torch.cat(vectors)
    if flat.is_cuda:
        torch.distributed.all_reduce(flat, op=torch.distributed.ReduceOp.AVG)
    else:  # gloo has no mean
        torch.distributed.all_reduce(flat)
        flat /= num_processes
    parts = flat.split([vector.numel() for vector in vectors])
    torch._foreach_copy_(vectors, parts)  # pyright: ignore[reportPrivateImportUsage]

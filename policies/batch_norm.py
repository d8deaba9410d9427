"""Batch normalization of pictures that a compiler leaves whole."""

from typing import Any

import torch
from torch import Tensor, nn


@torch.library.custom_op("roboverse::batch_norm", mutates_args=(), tags=(torch.Tag.flexible_layout,))
def _normalize(pictures: Tensor, weight: Tensor, bias: Tensor, eps: float) -> tuple[Tensor, Tensor, Tensor]:
    """Returns what is normalized, and the mean and 1 / standard deviation of each channel."""
    return torch.native_batch_norm(pictures, weight, bias, None, None, True, 0.0, eps)


@_normalize.register_fake
def _(pictures: Tensor, weight: Tensor, bias: Tensor, eps: float) -> tuple[Tensor, Tensor, Tensor]:
    del bias, eps
    return torch.empty_like(pictures), torch.empty_like(weight), torch.empty_like(weight)


@torch.library.custom_op("roboverse::batch_norm_backward", mutates_args=(), tags=(torch.Tag.flexible_layout,))
def _backward(
    gradient: Tensor, pictures: Tensor, weight: Tensor, mean: Tensor, inverse_std: Tensor, eps: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Returns the gradients of the pictures, the weight and the bias."""
    if pictures.is_contiguous(memory_format=torch.channels_last):
        gradient = gradient.contiguous(memory_format=torch.channels_last)
    return torch.ops.aten.native_batch_norm_backward(
        gradient, pictures, weight, None, None, mean, inverse_std, True, eps, [True, True, True]
    )


@_backward.register_fake
def _(
    gradient: Tensor, pictures: Tensor, weight: Tensor, mean: Tensor, inverse_std: Tensor, eps: float
) -> tuple[Tensor, Tensor, Tensor]:
    del gradient, mean, inverse_std, eps
    return torch.empty_like(pictures), torch.empty_like(weight), torch.empty_like(weight)


def _keep(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    pictures, weight, _bias, ctx.eps = inputs
    ctx.save_for_backward(pictures, weight, *output[1:])


def _differentiate(ctx: Any, gradient: Tensor, *_: Tensor) -> tuple[Tensor | None, ...]:
    return (*_backward(gradient, *ctx.saved_tensors, ctx.eps), None)


_normalize.register_autograd(_differentiate, setup_context=_keep)


class BatchNorm2d(nn.BatchNorm2d):
    """PyTorch's, whose training is one operator to a compiler.

    Taken apart and fused with its neighbours by the compiler of PyTorch 2.11, a trained batch normalization
    in bf16 gives gradients that are NaN on an H200; as one operator of PyTorch's own it gives those of eager
    code, and what lies between two of them is fused.
    """

    def forward(self, input: Tensor) -> Tensor:
        """Normalizes pictures (B, C, H, W); in training by their own statistics, which it averages."""
        if not self.training or self.running_mean is None or self.running_var is None or not self.momentum:
            return super().forward(input)
        output, mean, inverse_std = _normalize(input, self.weight, self.bias, self.eps)
        with torch.no_grad():
            samples = input.numel() // input.shape[1]
            variance = (inverse_std.pow(-2) - self.eps) * (samples / max(1, samples - 1))
            self.running_mean.lerp_(mean, self.momentum)
            self.running_var.lerp_(variance, self.momentum)
        return output

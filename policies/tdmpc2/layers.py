"""The layers that TD-MPC2 is made of.

Shapes: ... any leading axes, Q members of the ensemble, N images.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

PIXELS = 64
"""Height and width of the images that the pixel encoder takes, as published."""

_INIT_STD = 0.02


class SimNorm(nn.Module):
    """Simplicial normalization: every ``dim`` entries are a softmax (arXiv:2310.16828, equation 5).

    Args:
        dim: Entries of a simplex.
    """

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.dim = dim

    def forward(self, x: Tensor) -> Tensor:
        """Normalizes the last axis, whose size is a multiple of ``dim``."""
        return functional.softmax(x.unflatten(-1, (-1, self.dim)), dim=-1).flatten(-2)


class NormedLinear(nn.Linear):
    """A linear layer, layer normalization, and an activation, by default Mish."""

    def __init__(self, in_features: int, out_features: int, activation: nn.Module | None = None) -> None:
        super().__init__(in_features, out_features)
        self.norm = nn.LayerNorm(out_features)
        self.activation = nn.Mish() if activation is None else activation

    def forward(self, input: Tensor) -> Tensor:
        """Transforms the last axis."""
        return self.activation(self.norm(super().forward(input)))


def mlp(in_dim: int, hidden: list[int], out_dim: int, activation: nn.Module | None = None) -> nn.Sequential:
    """Returns an MLP of normed layers.

    Args:
        in_dim: Size of the input.
        hidden: Widths of the hidden layers.
        out_dim: Size of the output.
        activation: Activation of the last layer, which is then normed too; None leaves it linear.
    """
    widths = [in_dim, *hidden]
    layers: list[nn.Module] = [NormedLinear(a, b) for a, b in pairwise(widths)]
    if activation is None:
        return nn.Sequential(*layers, nn.Linear(widths[-1], out_dim))
    return nn.Sequential(*layers, NormedLinear(widths[-1], out_dim, activation))


class QEnsemble(nn.Module):
    """MLPs of one form, evaluated together: one batched matrix product per layer.

    ``torch.baddbmm`` took 439 ms forward and backward where ``torch.vmap`` took 487, and 116 ms forward
    where it took 172 (CPU, size 5, batch 256), and a pair is evaluated without the others.

    Args:
        num_q: Members.
        in_dim: Size of the input.
        width: Width of both hidden layers.
        out_dim: Size of the output.
        dropout: Dropout in the first layer.
    """

    def __init__(self, num_q: int, in_dim: int, width: int, out_dim: int, dropout: float) -> None:
        super().__init__()
        self.num_q, self.dropout = num_q, dropout
        sizes = [(in_dim, width), (width, width), (width, out_dim)]
        self.weights = nn.ParameterList([nn.Parameter(torch.empty(num_q, a, b)) for a, b in sizes])
        self.biases = nn.ParameterList([nn.Parameter(torch.zeros(num_q, 1, b)) for _, b in sizes])
        self.scales = nn.ParameterList([nn.Parameter(torch.ones(num_q, 1, width)) for _ in range(2)])
        self.shifts = nn.ParameterList([nn.Parameter(torch.zeros(num_q, 1, width)) for _ in range(2)])
        for weight in list(self.weights)[:-1]:
            nn.init.trunc_normal_(weight, std=_INIT_STD)
        nn.init.zeros_(self.weights[-1])  # every value is zero at first

    def forward(self, x: Tensor, members: Tensor | None = None, *, detached: bool = False) -> Tensor:
        """Evaluates the ensemble.

        Args:
            x: Inputs (..., in_dim).
            members: Which members, (K,) int64; None is all of them.
            detached: Let no gradient reach the weights.

        Returns:
            Outputs (K, ..., out_dim).
        """

        def own(parameter: Tensor) -> Tensor:
            tensor = parameter.detach() if detached else parameter
            return tensor if members is None else tensor.index_select(0, members)

        num = self.num_q if members is None else members.shape[0]
        h = x.flatten(0, -2).expand(num, -1, -1)
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            h = torch.baddbmm(own(bias), h, own(weight))
            if i < len(self.scales):
                h = functional.dropout(h, self.dropout, self.training) if i == 0 else h
                h = functional.layer_norm(h, h.shape[-1:]) * own(self.scales[i]) + own(self.shifts[i])
                h = functional.mish(h)
        return h.unflatten(1, x.shape[:-1])


class ShiftAug(nn.Module):
    """Random shifts of images by whole pixels, borders repeated (DrQ-v2, arXiv:2107.09645).

    Shifts by gathering pixels, which is exact and needs no interpolation. One index for all channels took 25
    ms of 256 observations of 9 channels, one for each pixel of each channel 183 ms (one CPU core).

    Args:
        pad: Largest shift, pixels.
    """

    def __init__(self, pad: int = 3) -> None:
        super().__init__()
        self.pad = pad

    def forward(self, x: Tensor, shift: Tensor | None = None) -> Tensor:
        """Shifts images (N, C, H, W), each by its own ``shift`` (N, 2) in [-pad, pad]: down and right."""
        n, channels, height, width = x.shape
        if shift is None:
            shift = torch.randint(-self.pad, self.pad + 1, (n, 2), device=x.device)
        rows = (torch.arange(height, device=x.device) - shift[:, :1]).clamp(0, height - 1)  # (N, H)
        columns = (torch.arange(width, device=x.device) - shift[:, 1:]).clamp(0, width - 1)  # (N, W)
        pixels = (rows[:, :, None] * width + columns[:, None]).flatten(1)  # (N, H W), of every channel
        return x.flatten(2).gather(2, pixels[:, None].expand(-1, channels, -1)).view_as(x)


class PixelEncoder(nn.Module):
    """Four convolutions, as published, of images with 64 by 64 pixels.

    Images are shifted at random while it learns, as in DrQ-v2 (arXiv:2107.09645). The authors' code shifts
    them when it acts, too; then an action would not follow from what is seen.

    Args:
        in_channels: Channels: three times the images of an observation.
        num_channels: Channels of every layer.
        latent_dim: Size of the latent state; another one than the convolutions' 16 numbers a channel adds the
            last layer of the encoder of states.
        simnorm_dim: Entries of a simplex.
    """

    def __init__(self, in_channels: int, num_channels: int, latent_dim: int, simnorm_dim: int) -> None:
        super().__init__()
        self.augment = ShiftAug()
        sizes = ((in_channels, 7, 2), (num_channels, 5, 2), (num_channels, 3, 2), (num_channels, 3, 1))
        layers: list[nn.Module] = []
        for channels, kernel, stride in sizes:
            layers += [nn.Conv2d(channels, num_channels, kernel, stride), nn.ReLU()]
        self.convolutions = nn.Sequential(*layers[:-1], nn.Flatten())
        size = num_channels * _output_pixels() ** 2
        norm = SimNorm(simnorm_dim)
        # Normed: small weights alone made all latent states alike, and predicting them so cost nothing.
        self.project = norm if size == latent_dim else NormedLinear(size, latent_dim, norm)

    def forward(self, pixels: Tensor) -> Tensor:
        """Encodes images (..., C, 64, 64), 0 to 255, as (..., latent_dim)."""
        flat = pixels.flatten(0, -4)
        flat = self.augment(flat) if self.training else flat
        flat = (flat - 127.5).div_(255.0)  # / 255 - 0.5, in half the memory
        return self.project(self.convolutions(flat)).unflatten(0, pixels.shape[:-3])


def _output_pixels() -> int:
    size = PIXELS
    for kernel, stride in ((7, 2), (5, 2), (3, 2), (3, 1)):
        size = (size - kernel) // stride + 1
    return size


def initialize(module: nn.Module) -> None:
    """Sets the first weights of a layer as the authors do; for ``nn.Module.apply``."""
    if isinstance(module, nn.Linear):
        nn.init.trunc_normal_(module.weight, std=_INIT_STD)
        nn.init.zeros_(module.bias)
    elif isinstance(module, nn.Embedding):
        nn.init.uniform_(module.weight, -_INIT_STD, _INIT_STD)

"""Actor, critics and normalization of FastTD3.

Shapes: B samples, D observation, A action, K atoms; 2 is the two critics.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

_EPS = 1e-2


class RunningNorm(nn.Module):
    """Observations less their running mean, over their running deviation.

    Args:
        size: D.
    """

    mean: Tensor
    var: Tensor
    count: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("var", torch.ones(size))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    @torch.no_grad()
    def update(self, x: Tensor) -> None:
        """Updates the running mean and variance with observations (B, D)."""
        self.count += len(x)
        share = (len(x) / self.count).to(x.dtype)
        apart = x.mean(0) - self.mean
        self.var += share * (x.var(0, correction=0) - self.var + apart.square() * (1.0 - share))
        self.mean += share * apart

    def forward(self, x: Tensor) -> Tensor:
        """Normalizes observations (..., D)."""
        return (x - self.mean) / (self.var.sqrt() + _EPS)


class Actor(nn.Module):
    """The action that is thought best.

    Args:
        observation_size: D.
        action_size: A.
        dim: Width of the first hidden layer; the next are a half and a quarter of it.
        init_scale: Deviation of the first weights of the last layer.
        layer_norm: Normalize hidden layers.
    """

    def __init__(
        self, observation_size: int, action_size: int, dim: int, init_scale: float, *, layer_norm: bool
    ) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for a, b in pairwise((observation_size, dim, dim // 2, dim // 4)):
            layers += [nn.Linear(a, b), *([nn.LayerNorm(b)] if layer_norm else []), nn.ReLU()]
        last = nn.Linear(dim // 4, action_size)
        nn.init.normal_(last.weight, 0.0, init_scale)
        nn.init.zeros_(last.bias)
        self.layers = nn.Sequential(*layers, last, nn.Tanh())

    def forward(self, observation: Tensor) -> Tensor:
        """Returns actions (B, A) in [-1, 1] for normalized observations (B, D)."""
        return self.layers(observation)


class Critics(nn.Module):
    """Two distributions of the value of an action, evaluated together.

    Args:
        observation_size: D.
        action_size: A.
        dim: Width of the first hidden layer; the next are a half and a quarter of it.
        num_atoms: K.
        v_min: Value of the first atom.
        v_max: Value of the last.
        layer_norm: Normalize hidden layers.
    """

    atoms: Tensor

    def __init__(
        self,
        observation_size: int,
        action_size: int,
        dim: int,
        num_atoms: int,
        v_min: float,
        v_max: float,
        *,
        layer_norm: bool,
    ) -> None:
        super().__init__()
        sizes = list(pairwise((observation_size + action_size, dim, dim // 2, dim // 4, num_atoms)))
        self.weights = nn.ParameterList([nn.Parameter(torch.empty(2, a, b)) for a, b in sizes])
        self.biases = nn.ParameterList([nn.Parameter(torch.empty(2, 1, b)) for _, b in sizes])
        for (a, _), weight, bias in zip(sizes, self.weights, self.biases, strict=True):
            bound = a**-0.5  # as of a linear layer of torch
            nn.init.uniform_(weight, -bound, bound)
            nn.init.uniform_(bias, -bound, bound)
        self.layer_norm = layer_norm
        self.register_buffer("atoms", torch.linspace(v_min, v_max, num_atoms), persistent=False)

    def forward(self, observation: Tensor, action: Tensor, *, detached: bool = False) -> Tensor:
        """Returns the logits (2, B, K) of actions (B, A); ``detached`` stops gradients to the weights."""
        h = torch.cat([observation, action], dim=-1).expand(2, -1, -1)
        last = len(self.weights) - 1
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            weight, bias = (weight.detach(), bias.detach()) if detached else (weight, bias)
            h = torch.bmm(h, weight) + bias
            if i < last:
                h = functional.layer_norm(h, h.shape[-1:]) if self.layer_norm else h
                h = functional.relu(h)
        return h

    def value(self, probabilities: Tensor) -> Tensor:
        """Returns the mean (...) of distributions (..., K)."""
        return (probabilities * self.atoms).sum(-1)


def project(probabilities: Tensor, values: Tensor, atoms: Tensor) -> Tensor:
    """Projects distributions onto evenly spaced atoms (C51, arXiv:1707.06887, algorithm 1).

    Each value's mass is split between its two neighbouring atoms, by nearness; values beyond are clamped.

    Args:
        probabilities: Masses (..., K), of any number of distributions over the same values.
        values: Where the masses are (B, K); broadcasts to them.
        atoms: Where they shall be (K,).
    """
    step = (atoms[-1] - atoms[0]) / (len(atoms) - 1)
    position = (values.clamp(atoms[0], atoms[-1]) - atoms[0]) / step
    lower = position.floor().clamp(0, len(atoms) - 2)
    share = (position - lower).expand_as(probabilities)
    index = lower.long().expand_as(probabilities)
    projected = torch.zeros_like(probabilities).scatter_add(-1, index, probabilities * (1.0 - share))
    return projected.scatter_add(-1, index + 1, probabilities * share)

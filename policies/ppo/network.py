"""The networks of PPO: normalization of what is seen, and perceptrons.

The names of the tensors are the form in which every backend's weights are saved.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

EPS = 1e-2
"""Added to standard deviations, as rsl_rl's ``EmpiricalNormalization`` does."""

ACTIVATIONS: dict[str, type[nn.Module]] = {"elu": nn.ELU, "tanh": nn.Tanh, "relu": nn.ReLU}


class RunningNorm(nn.Module):
    """Takes off the mean of all that was seen, and divides by its standard deviation.

    Args:
        size: Entries of an observation.
    """

    mean: Tensor
    var: Tensor
    count: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("var", torch.ones(size))
        self.register_buffer("count", torch.zeros(()))

    def forward(self, seen: Tensor) -> Tensor:
        """Normalizes observations (…, D)."""
        return (seen - self.mean) / (self.var.sqrt() + EPS)

    @torch.no_grad()
    def update(self, seen: Tensor) -> None:
        """Takes observations (n, D) into account (Chan et al. 1979, equation 2.1)."""
        var, mean = torch.var_mean(seen, dim=0, correction=0)
        self.count += len(seen)
        rate = len(seen) / self.count
        delta = mean - self.mean
        self.mean += rate * delta
        self.var += rate * (var - self.var + delta * (mean - self.mean))


def perceptron(size_in: int, hidden: Sequence[int], size_out: int, activation: str) -> nn.Sequential:
    """Returns linear layers with activations between them."""
    sizes = [size_in, *hidden]
    layers: list[nn.Module] = []
    for before, after in pairwise(sizes):
        layers += [nn.Linear(before, after), ACTIVATIONS[activation]()]
    return nn.Sequential(*layers, nn.Linear(sizes[-1], size_out))


class Actor(nn.Module):
    """The mean action of an observation, and the standard deviation of its noise.

    Args:
        observation_size: D.
        action_size: A.
        hidden: Widths of the hidden layers.
        activation: Name of the activation.
        init_std: First standard deviation.
    """

    def __init__(
        self, observation_size: int, action_size: int, hidden: Sequence[int], activation: str, init_std: float
    ) -> None:
        super().__init__()
        self.norm = RunningNorm(observation_size)
        self.layers = perceptron(observation_size, hidden, action_size, activation)
        self.log_std = nn.Parameter(torch.full((action_size,), init_std).log())

    def forward(self, seen: Tensor) -> Tensor:
        """Returns mean actions (…, A), which are not clipped."""
        return self.layers(self.norm(seen))

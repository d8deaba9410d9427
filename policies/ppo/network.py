"""The networks of PPO: what features they make of an observation, and perceptrons.

The names of the tensors are the form in which every backend's weights are saved.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from policies.byte_rows import row_size, unpack

EPS = 1e-2
"""Added to standard deviations, as rsl_rl's ``EmpiricalNormalization`` does."""

ACTIVATIONS: dict[str, type[nn.Module]] = {"elu": nn.ELU, "tanh": nn.Tanh, "relu": nn.ReLU}


class RunningNorm(nn.Module):
    """Takes off the mean of all that was seen, and divides by its standard deviation.

    Args:
        size: Entries of an observation.

    Attributes:
        size_in: Entries of an observation.
        size: Entries of its features, as many.
        dtype_in: Type of an observation.
    """

    mean: Tensor
    var: Tensor
    count: Tensor
    dtype_in = torch.float32

    def __init__(self, size: int) -> None:
        super().__init__()
        self.size_in = self.size = size
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


LEAST_PIXELS = 36
"""Pixels a side that the convolutions of :class:`PixelEncoder` need at least."""

_IMAGE_FEATURES = _STATE_FEATURES = 256


class PixelEncoder(nn.Module):
    """Features of images and the robot's own state: the convolutions of DQN, and a linear layer of the state.

    As in ManiSkill 3's PPO for images (``examples/baselines/ppo/ppo_rgb.py``, Apache-2.0): the images of all
    cameras are channels of one, 32, 64 and 64 channels with kernels of 8, 4 and 3 and strides of 4, 2 and 1
    (Mnih et al. 2015, doi:10.1038/nature14236), and 256 features of the images beside 256 of the state. Here
    the state is normalized, pixels are from -0.5 to 0.5, or the first gradients would move all weights of a
    channel alike and leave it dead, and several frames are seen side by side.

    Shapes: F frames, C = 3 × cameras channels of a frame, P pixels a side, S numbers of the state.

    Args:
        num_cameras: Cameras.
        pixels: P.
        num_state: S.
        num_frames: F.

    Attributes:
        size_in: Bytes of an observation.
        size: Entries of its features.
        dtype_in: Type of an observation.
    """

    dtype_in = torch.uint8

    def __init__(self, num_cameras: int, pixels: int, num_state: int, num_frames: int) -> None:
        super().__init__()
        self.image_shape = (3 * num_cameras, pixels, pixels)
        self.frame_size = row_size(self.image_shape, num_state)
        self.size_in, self.size = num_frames * self.frame_size, _IMAGE_FEATURES + _STATE_FEATURES
        sizes = ((3 * num_cameras * num_frames, 32, 8, 4), (32, 64, 4, 2), (64, 64, 3, 1))
        layers: list[nn.Module] = []
        for channels_in, channels, kernel, stride in sizes:
            layers += [nn.Conv2d(channels_in, channels, kernel, stride), nn.ReLU()]
            pixels = (pixels - kernel) // stride + 1
        self.images = nn.Sequential(
            *layers, nn.Flatten(), nn.Linear(64 * pixels**2, _IMAGE_FEATURES), nn.ReLU()
        )
        self.norm = RunningNorm(num_frames * num_state)
        self.state = nn.Linear(num_frames * num_state, _STATE_FEATURES)

    def forward(self, seen: Tensor) -> Tensor:
        """Returns the features (…, 512) of rows of bytes (…, F (C P P + 4 S))."""
        images, state = self._unpacked(seen.flatten(0, -2))
        features = (self.images(images.float().div_(255.0).sub_(0.5)), self.state(self.norm(state)))
        return torch.cat(features, dim=-1).unflatten(0, seen.shape[:-1])

    def update(self, seen: Tensor) -> None:
        """Takes the states in rows of bytes (n, F (C P P + 4 S)) into account."""
        self.norm.update(self._unpacked(seen)[1])

    def _unpacked(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the frames of rows (n, …) side by side: (n, F C, P, P) uint8, and (n, F S)."""
        images, state = unpack(rows.unflatten(-1, (-1, self.frame_size)), self.image_shape)
        return images.flatten(1, 2), state.flatten(1)


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
        features: Makes features of an observation; it has the name ``norm`` in every checkpoint.
        action_size: A.
        hidden: Widths of the hidden layers.
        activation: Name of the activation.
        init_std: First standard deviation.
    """

    def __init__(
        self,
        features: RunningNorm | PixelEncoder,
        action_size: int,
        hidden: Sequence[int],
        activation: str,
        init_std: float,
    ) -> None:
        super().__init__()
        self.norm = features
        self.layers = perceptron(features.size, hidden, action_size, activation)
        self.log_std = nn.Parameter(torch.full((action_size,), init_std).log())

    def forward(self, seen: Tensor) -> Tensor:
        """Returns mean actions (…, A), which are not clipped."""
        return self.layers(self.norm(seen))

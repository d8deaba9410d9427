"""A policy of one's own: a small convolutional network that predicts a chunk of actions."""

from dataclasses import dataclass
from typing import Any, ClassVar, override

import torch
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss

from policies.trainable import TrainablePolicy


@dataclass(frozen=True, kw_only=True)
class ChunkCnnConfig:
    """Settings of the network, typed as in ``policy.hidden_dim=128``.

    Attributes:
        chunk_size: Actions that one call predicts.
        n_action_steps: Actions of a chunk that are executed before the next call.
        channels: Channels of each convolution; each halves the image.
        hidden_dim: Width of the hidden layer.
    """

    chunk_size: int = 16
    n_action_steps: int = 8
    channels: tuple[int, ...] = (16, 32, 32)
    hidden_dim: int = 256


class ChunkCnn(TrainablePolicy):
    """Images and joint positions to a chunk of actions.

    Args:
        config: Settings.
        shapes: Shape of one entry of each observation and of the action.
    """

    config_class: ClassVar = ChunkCnnConfig

    def __init__(self, config: ChunkCnnConfig, shapes: dict[str, tuple[int, ...]]) -> None:
        super().__init__(config, shapes)
        layers: list[nn.Module] = []
        for width in config.channels:
            layers += [nn.LazyConv2d(width, 3, stride=2, padding=1), nn.ReLU()]
        self.encoder = nn.Sequential(*layers, nn.Flatten())
        (action_dim,) = shapes["action"]
        self.head = nn.Sequential(
            nn.LazyLinear(config.hidden_dim),
            nn.ReLU(),
            nn.Linear(config.hidden_dim, config.chunk_size * action_dim),
            nn.Unflatten(1, (config.chunk_size, action_dim)),
        )
        self.act({key: torch.zeros(1, *shape) for key, shape in shapes.items()})  # sizes of the lazy layers

    @override
    def compute_loss(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        actions = self.act(batch)
        inside = ~batch["action_is_pad"]  # without what repeats the last action after the end of an episode
        loss = smooth_l1_loss(actions[inside], batch["action"][inside])
        return loss, {"first_action_error": (actions[:, 0] - batch["action"][:, 0]).abs().mean()}

    @override
    def act(self, observation: dict[str, Tensor]) -> Tensor:
        seen = [self.encoder(observation[key]) for key in self.image_keys]
        return self.head(torch.cat([*seen, observation["observation.state"]], 1))

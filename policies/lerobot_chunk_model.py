"""What our own models that predict chunks share as LeRobot's commands use them.

``lerobot-train`` and ``lerobot-eval`` execute chunks by this; elsewhere :mod:`policies.imitation` does. A
policy type has a :class:`ChunkConfig` and a :class:`ChunkPolicy`; its network is a module of its own.
"""

from collections import deque
from typing import Any

import torch
from lerobot.configs import PreTrainedConfig
from lerobot.optim import AdamWConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import OBS_IMAGES
from torch import Tensor, nn

from envs.core.errors import PolicyError


class ChunkConfig(PreTrainedConfig):
    """A policy that sees the newest frame and predicts ``chunk_size`` actions.

    Its fields are those of the subclass, a dataclass.
    """

    chunk_size: int
    n_action_steps: int
    optimizer_lr: float
    optimizer_weight_decay: float

    def get_optimizer_preset(self) -> AdamWConfig:
        """Returns the optimizer of ``lerobot-train``."""
        return AdamWConfig(lr=self.optimizer_lr, weight_decay=self.optimizer_weight_decay)

    def get_scheduler_preset(self) -> None:
        """Returns nothing: ``lerobot-train`` keeps its learning rate."""

    def validate_features(self) -> None:
        """Checks the inputs and outputs.

        Raises:
            ValueError: There is no image, no state or no action.
        """
        if not self.image_features or self.robot_state_feature is None or self.action_feature is None:
            raise ValueError(f"{self.type} takes at least one image and a state, and gives actions.")

    @property
    def observation_delta_indices(self) -> None:
        """Frames of an observation: the newest alone."""

    @property
    def action_delta_indices(self) -> list[int]:
        """Frames of the actions of a training sample."""
        return list(range(self.chunk_size))

    @property
    def reward_delta_indices(self) -> None:
        """Frames of the rewards: none are read."""


class ChunkPolicy(PreTrainedPolicy):
    """A policy that executes the first actions of each chunk.

    Args:
        config: Its configuration.
        network: What predicts the actions.
    """

    config_class: Any = ChunkConfig  # LeRobot's base class declares both as None
    name: Any = "chunk"

    def __init__(self, config: Any, network: nn.Module) -> None:
        super().__init__(config)
        self.config: Any = config
        self.model: Any = network
        self.reset()

    def get_optim_params(self) -> Any:
        """Returns all parameters: they share one learning rate."""
        return self.parameters()

    def reset(self) -> None:
        """Drops the chunk that is being executed."""
        self._queue: deque[Tensor] = deque(maxlen=self.config.n_action_steps)

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], **_: Any) -> Tensor:
        """Returns the next action (B, A), from a new chunk once the last one is used up."""
        if not self._queue:
            chunk = self.predict_action_chunk(batch)[:, : self.config.n_action_steps]
            self._queue.extend(chunk.unbind(1))
        return self._queue.popleft()

    def inputs(self, batch: dict[str, Tensor]) -> dict[str, Any]:
        """Returns a batch as the network takes it, with its images in a list.

        Raises:
            PolicyError: An image of a camera that the policy was trained with is missing.
        """
        seen = list(self.config.image_features)
        if missing := [key for key in seen if key not in batch]:
            given = ", ".join(key for key in batch if key.startswith(f"{OBS_IMAGES}.")) or "no image"
            example = f'--rename_map=\'{{"{OBS_IMAGES}.<camera>": "{missing[0]}"}}\''
            raise PolicyError(
                f"The policy sees {', '.join(seen)}; missing: {', '.join(missing)}; given: {given}. Give "
                f"what is missing, or rename what is given ({example})."
            )
        return {**batch, OBS_IMAGES: [batch[key] for key in seen]}

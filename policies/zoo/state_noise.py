"""Noise on the state of the samples that a LeRobot policy learns from."""

from dataclasses import dataclass
from typing import Any, Self

import torch
from lerobot.utils.constants import OBS_STATE
from torch import Tensor


@dataclass(frozen=True, slots=True)
class NoisyState:
    """Adds noise to the states of a batch, before LeRobot's processors: some write the state as text.

    Attributes:
        deviation: Standard deviation of the noise of each entry of the state, in that entry's unit.
    """

    deviation: Tensor

    @classmethod
    def of(cls, deviation: Any, noise: float) -> Self:
        """Returns noise in proportion to how far the states of demonstrations spread.

        Args:
            deviation: Standard deviation of each entry over the demonstrations, shape (state size,).
            noise: Standard deviation of the noise, relative to that.
        """
        return cls(torch.as_tensor(deviation, dtype=torch.float32).reshape(-1) * noise)

    def __call__(self, batch: dict[str, Any]) -> dict[str, Any]:
        """Returns a batch with noise on its states, shape (n, [T,] state size)."""
        state = batch[OBS_STATE]
        return batch | {OBS_STATE: state + self.deviation.to(state.device) * torch.randn_like(state)}

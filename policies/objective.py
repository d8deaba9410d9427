"""The loss of a policy as one function of raw frames, which compiles as a whole.

LeRobot's processors and losses stop for the host in every step: they look values up by name, move them,
and ask for numbers. A gradient step of a small policy then waits for Python, not for the GPU.
"""

from collections.abc import Callable
from typing import Any

import torch
from lerobot.configs import NormalizationMode
from lerobot.processor import NormalizerProcessorStep
from torch import Tensor, nn

from envs.core.errors import PolicyError
from policies.normalization import KeyNormalizer, Terms

type Loss = tuple[Tensor, dict[str, Tensor]]
"""The loss, and its terms by name: tensors without dimensions."""


class Normalizer(KeyNormalizer):
    """LeRobot's normalization of each key.

    Equal to it bit by bit: ``2 (x - min) / (max - min) - 1`` rounds as ``(x - min) / ((max - min) / 2) - 1``.

    Args:
        step: The step of a policy's preprocessor.
        device: Torch device.
    """

    def __init__(self, step: NormalizerProcessorStep, device: torch.device) -> None:
        terms: dict[str, Terms] = {}
        for key, feature in step.features.items():
            mode = step.norm_map.get(feature.type, NormalizationMode.IDENTITY)
            stats = {name: value.to(device) for name, value in (step._tensor_stats.get(key) or {}).items()}
            if mode is NormalizationMode.IDENTITY or not stats:
                continue
            if mode is NormalizationMode.MEAN_STD:
                terms[key] = stats["mean"], stats["std"] + step.eps, 0.0
            elif mode is NormalizationMode.MIN_MAX:
                terms[key] = stats["min"], (stats["max"] - stats["min"]) / 2.0, -1.0
            else:
                raise PolicyError(f"'{key}' is normalized by {mode.value}, which training does not support.")
        super().__init__(terms)


class Objective(nn.Module):
    """Raw frames to the loss of a policy.

    Args:
        model: The network, whose parameters are trained.
        normalizer: What is done to the frames first.
        loss: The loss of a normalized batch.
    """

    def __init__(
        self, model: nn.Module, normalizer: nn.Module, loss: Callable[[dict[str, Tensor]], Loss]
    ) -> None:
        super().__init__()
        self.model, self.normalizer = model, normalizer
        self._loss = loss

    def forward(self, batch: dict[str, Tensor]) -> Loss:
        """Returns the loss of a batch as a dataset gives it, and its terms."""
        return self._loss(self.normalizer(batch))


class Preprocess(nn.Module):
    """A policy's own ``preprocess`` as a module without parameters, in place of a normalizer.

    Args:
        policy: Whose method it is; no part of the module, which must not own the network twice.
        change: What is done to raw frames before, in training alone; None leaves them as they are.
    """

    def __init__(self, policy: Any, change: Callable[[dict[str, Any]], dict[str, Any]] | None = None) -> None:
        super().__init__()
        self._preprocess, self._change = policy.preprocess, change

    def forward(self, batch: dict[str, Any]) -> dict[str, Any]:
        """Returns a batch as the loss takes it."""
        return self._preprocess(batch if self._change is None else self._change(batch))


def normalizer_step(preprocessor: Any) -> NormalizerProcessorStep:
    """Returns the step of a preprocessor that normalizes."""
    return next(step for step in preprocessor.steps if isinstance(step, NormalizerProcessorStep))

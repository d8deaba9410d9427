"""Normalization of observations and actions by the statistics of a dataset."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from envs.core.errors import PolicyError

IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
HALF = ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))

# The original ACT clips standard deviations at 1e-2 and the original Diffusion Policy maps a constant
# dimension to 0: a joint that never moves in the demonstrations must not be amplified without bound.
_MIN_STD = 1e-2
_MIN_RANGE = 1e-4

type Terms = tuple[Tensor, Tensor, float]
"""Shift, scale and offset of a key."""


class KeyNormalizer(nn.Module):
    """Normalizes the entries of a batch by key, as ``(x - shift) / scale + offset``.

    Args:
        terms: Shift, scale and offset by key; other keys are left as they are.
        persistent: Whether they are part of the module's state.
    """

    def __init__(self, terms: Mapping[str, Terms], *, persistent: bool = False) -> None:
        super().__init__()
        self.offsets: dict[str, float] = {}
        for key, (shift, scale, offset) in terms.items():
            self.offsets[key] = offset
            self.register_buffer(f"shift_{_plain(key)}", shift, persistent=persistent)
            self.register_buffer(f"scale_{_plain(key)}", scale, persistent=persistent)

    def forward(self, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Normalizes a batch; images in bytes become float32 from 0 to 1 first."""
        out = {}
        for key, value in batch.items():
            is_own = value.dtype is torch.uint8  # then a new tensor, which may be changed in place
            value = value.float().div_(255.0) if is_own else value
            if key in self.offsets:
                shift, offset = self._shift(key), self.offsets[key]
                value = (value.sub_(shift) if is_own else value - shift).div_(self._scale(key))
                value = value.add_(offset) if offset else value
            out[key] = value
        return out

    def restore(self, key: str, value: Tensor) -> Tensor:
        """Returns what the entry of a key was before it was normalized."""
        return (value - self.offsets[key]) * self._scale(key) + self._shift(key)

    def set_terms(self, key: str, shift: Tensor, scale: Tensor) -> None:
        """Sets the shift and the scale of a key."""
        self._shift(key).copy_(shift)
        self._scale(key).copy_(scale)

    def _shift(self, key: str) -> Tensor:
        return getattr(self, f"shift_{_plain(key)}")

    def _scale(self, key: str) -> Tensor:
        return getattr(self, f"scale_{_plain(key)}")


def _plain(key: str) -> str:
    return key.replace(".", "_")


def policy_stats(
    keys: Mapping[str, bool], stats: Mapping[str, Mapping[str, Any]], image_stats: str
) -> dict[str, dict[str, Any]]:
    """Chooses and guards the statistics of the keys of a policy.

    Args:
        keys: Keys of the policy, and whether each is an image.
        stats: Statistics of the dataset: per key ``mean``, ``std``, ``min`` and ``max``.
        image_stats: ``dataset``, ``imagenet`` or ``half``.

    Returns:
        Per key ``mean``, ``std``, ``min``, ``max`` as float32 tensors; (3, 1, 1) for images.

    Raises:
        PolicyError: if the dataset has no statistics of a key.
    """
    return {
        key: _image(key, stats, image_stats) if is_image else _vector(key, stats)
        for key, is_image in keys.items()
    }


def _of(key: str, stats: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    names = ("mean", "std", "min", "max")
    missing = [name for name in names if name not in stats.get(key, {})]
    if missing:
        raise PolicyError(f"The dataset has no {', '.join(missing)} of '{key}' in its statistics; "
                          "write the dataset again.")  # fmt: skip
    return {name: torch.as_tensor(stats[key][name], dtype=torch.float32).clone() for name in names}


def _vector(key: str, stats: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    own = _of(key, stats)
    own["std"] = own["std"].clamp_min(_MIN_STD)
    constant = own["max"] - own["min"] < _MIN_RANGE
    own["min"] = torch.where(constant, own["min"] - 1.0, own["min"])
    own["max"] = torch.where(constant, own["max"] + 1.0, own["max"])
    return own


def _image(key: str, stats: Mapping[str, Mapping[str, Any]], image_stats: str) -> dict[str, Any]:
    if image_stats == "dataset":
        own = {name: value.reshape(-1, 1, 1) for name, value in _of(key, stats).items()}
        own["std"] = own["std"].clamp_min(_MIN_STD)
        return own
    mean, std = (torch.tensor(value).reshape(3, 1, 1) for value in _FIXED[image_stats])
    return {"mean": mean, "std": std, "min": torch.zeros(3, 1, 1), "max": torch.ones(3, 1, 1)}


_FIXED = {"imagenet": IMAGENET, "half": HALF}

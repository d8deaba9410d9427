"""Observations without images, as one vector: what reinforcement learning policies see."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from envs.core.errors import PolicyError
from policies.base import Observation, observed


def check_generators(num: int, generators: Sequence[torch.Generator] | None) -> None:
    """Checks that there is one generator per environment, or none at all.

    Raises:
        PolicyError: if there are more or fewer.
    """
    if generators is not None and len(generators) != num:
        raise PolicyError(f"act() needs one generator per environment: {num}, given {len(generators)}.")


def joined(observation: Observation, sizes: Mapping[str, int], policy: str) -> Tensor:
    """Returns the vectors of an observation side by side, (n, D) float32 on the CPU.

    Args:
        observation: Arrays (n, size) by key.
        sizes: Keys that the policy sees, in order, and their sizes.
        policy: Its name, for messages.

    Raises:
        PolicyError: if a key is absent or of another size.
    """
    parts = [observed(observation, key, (size,), policy) for key, size in sizes.items()]
    return torch.from_numpy(np.concatenate(parts, axis=1, dtype=np.float32))


def sizes_of(content: Mapping[str, Any]) -> dict[str, int]:
    """Reads sizes by key from a configuration file."""
    return {str(key): int(size) for key, size in content.items()}

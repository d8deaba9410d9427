"""Observations without pictures, as one vector: what policies that learn by reward see."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from policies.base import Observation, PolicyError


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
    parts = []
    for key, size in sizes.items():
        if key not in observation:
            raise PolicyError(
                f"The observation has no '{key}', which policy '{policy}' needs. "
                f"Given: {', '.join(sorted(observation)) or 'nothing'}."
            )
        part = np.asarray(observation[key], np.float32)
        if part.ndim != 2 or part.shape[1] != size:
            raise PolicyError(
                f"'{key}' has shape {part.shape}, but policy '{policy}' was made for (n, {size}). "
                "Use the task and robot that it was trained on."
            )
        parts.append(torch.tensor(part))
    return torch.cat(parts, dim=1)


def sizes_of(content: Mapping[str, Any]) -> dict[str, int]:
    """Reads sizes by key from a configuration file."""
    return {str(key): int(size) for key, size in content.items()}

"""A run's random numbers: the seed of each step, and states of generators, saved with a checkpoint."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor


def step_seed(seed: int, step: int, rank: int) -> int:
    """Returns the seed of dropout, noise and augmentation of one gradient step in one process."""
    source = np.random.SeedSequence(seed, spawn_key=(step, rank))
    return int(source.generate_state(1, np.uint64)[0] >> 1)


def random_state(env: Any) -> dict[str, Tensor]:
    """Returns the states of torch's generators, and of the env's if it has ``random_state``."""
    states = {"cpu": torch.get_rng_state()}
    if env.device.type == "cuda":
        states["cuda"] = torch.cuda.get_rng_state(env.device)
    if hasattr(env, "random_state"):
        states["env"] = env.random_state()
    return states


def set_random_state(states: Mapping[str, Tensor], env: Any) -> None:
    """Restores the states of :func:`random_state`; generators without one stay as they are."""
    if "cpu" in states:
        torch.set_rng_state(states["cpu"])
    if "cuda" in states:
        torch.cuda.set_rng_state(states["cuda"], env.device)
    if "env" in states:
        env.set_random_state(states["env"])

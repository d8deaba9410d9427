"""How long imitation will take on this machine, measured."""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from policies.imitation import ImitationPolicy
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.device import cpu_threads, resolve_precision
from roboverse_learn.training.imitation.optimizer import make_optimizer

_SMALL_BATCH = 4
_NUM_SMALL_STEPS = 3
_QUICK_STEP_S = 0.3


def estimate_training_s(policy: ImitationPolicy, config: TrainConfig, num_timed_steps: int = 5) -> float:
    """Times gradient steps on random data and returns the seconds of the whole run.

    On a CPU a few samples stand for the batch of a large network, so that asking takes seconds, not minutes.
    On a GPU nothing is compiled for it, so that the run will take less. The steps change the policy.

    Args:
        policy: A policy of the kind to train.
        config: How it will be trained.
        num_timed_steps: Steps to time after one that warms up; the fastest counts.

    Returns:
        Seconds, at most the time limit of ``config``.
    """
    batch_size = config.batch_size
    with cpu_threads(config.num_threads, policy.device.type), torch.random.fork_rng():
        policy.begin_training()
        if policy.device.type == "cpu" and batch_size > _SMALL_BATCH:
            seconds = _step_s(policy, config, _SMALL_BATCH, _NUM_SMALL_STEPS)
            if seconds > _QUICK_STEP_S:
                policy.end_training()
                return config.limited_s(seconds * batch_size / _SMALL_BATCH * config.steps)
        seconds = _step_s(policy, config, batch_size, num_timed_steps)
        policy.end_training()
    return config.limited_s(seconds * config.steps)


def _step_s(policy: ImitationPolicy, config: TrainConfig, batch_size: int, num_timed_steps: int) -> float:
    """Returns the seconds of the fastest of some gradient steps, after one that warms up."""
    optimizer, objective = make_optimizer(policy, config), policy.objective()
    batch = _random_batch(policy, batch_size)
    bf16 = resolve_precision(config.precision, policy.device) == "bf16"
    seconds = []
    for _ in range(1 + num_timed_steps):
        start = time.perf_counter()
        with torch.autocast(policy.device.type, torch.bfloat16, enabled=bf16):
            loss, _terms = objective(batch)
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()
        float(loss.detach())  # waits for a GPU
        seconds.append(time.perf_counter() - start)
    return min(seconds[1:])


def _random_batch(policy: ImitationPolicy, batch_size: int) -> dict[str, Tensor]:
    """Returns a batch with the shapes that a dataset would give."""
    deltas, batch = policy.delta_indices, {}
    for key, of_one in policy.shapes.items():
        time_axis = (len(deltas[key]),) if key in deltas else ()
        shape = (batch_size, *time_axis)
        batch[key] = torch.rand(*shape, *of_one, device=policy.device)
        batch[f"{key}_is_pad"] = torch.zeros(
            *(shape if time_axis else (*shape, 1)), dtype=torch.bool, device=policy.device
        )
    for key in policy.columns:
        batch[key] = torch.zeros(batch_size, dtype=torch.int64, device=policy.device)
    return batch


def plain_stats(features: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Returns statistics that normalize nothing, for a policy without a dataset."""
    stats = {}
    for key, feature in features.items():
        shape = (3, 1, 1) if feature["dtype"] == "video" else tuple(feature["shape"])
        low, high = np.zeros(shape, np.float32), np.ones(shape, np.float32)
        stats[key] = {"mean": low, "std": high, "min": low, "max": high}
        stats[key] |= {"q01": low, "q10": low, "q90": high, "q99": high}
    return stats

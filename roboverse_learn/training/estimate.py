"""How long a training run will take on this machine, measured."""

import time

import torch
from torch import Tensor

from policies.lerobot_policy import LeRobotPolicy
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.device import cpu_threads, resolve_precision
from roboverse_learn.training.imitation import make_optimizer

_LARGEST_TIMED_BATCH = 4


def estimate_training_s(policy: LeRobotPolicy, config: TrainConfig, num_timed_steps: int = 1) -> float:
    """Times gradient steps on random data and returns the seconds of the whole run.

    On a CPU a few samples stand for the batch, so that asking takes seconds, not minutes. On a GPU nothing
    is compiled for it, so that the run will take less. The policy is changed by the steps: give it one
    that is not needed any more.

    Args:
        policy: A policy of the kind to train.
        config: How it will be trained.
        num_timed_steps: Steps to time after one that warms up; the fastest counts.

    Returns:
        Seconds, at most the time limit of ``config``.
    """
    on_cpu = policy.device.type == "cpu"
    batch_size = min(config.batch_size, _LARGEST_TIMED_BATCH) if on_cpu else config.batch_size
    with cpu_threads(config.num_threads, policy.device.type), torch.random.fork_rng():
        policy.begin_training()
        optimizer = make_optimizer(policy, config)
        objective = policy.objective()
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
        policy.end_training()
    total = min(seconds[1:]) * config.batch_size / batch_size * config.steps
    return total if config.time_limit_s is None else min(total, config.time_limit_s)


def _random_batch(policy: LeRobotPolicy, batch_size: int) -> dict[str, Tensor]:
    """Returns a batch with the shapes that a dataset would give."""
    deltas, batch = policy.delta_indices, {}
    for key, feature in policy.features.items():
        time_axis = (len(deltas[key]),) if key in deltas else ()
        shape = (batch_size, *time_axis)
        batch[key] = torch.rand(*shape, *feature.shape, device=policy.device)
        batch[f"{key}_is_pad"] = torch.zeros(
            *(shape if time_axis else (*shape, 1)), dtype=torch.bool, device=policy.device
        )
    return batch

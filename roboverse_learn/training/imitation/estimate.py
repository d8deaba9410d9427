"""How long a training run will take on this machine, measured."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from policies.imitation import ImitationPolicy
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.device import cpu_threads, resolve_precision
from roboverse_learn.training.imitation.optimizer import make_optimizer
from roboverse_learn.training.reporter import Reporter
from roboverse_learn.training.rl.loop import Loop

_SMALL_BATCH = 4
_NUM_SMALL_STEPS = 3
_QUICK_STEP_S = 0.3
_LEAST_TIMED_S, _MOST_TIMED_S = 1.0, 20.0


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
                return _limited(seconds * batch_size / _SMALL_BATCH * config.steps, config)
        seconds = _step_s(policy, config, batch_size, num_timed_steps)
        policy.end_training()
    return _limited(seconds * config.steps, config)


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


def estimate_learning_s(learner: Any) -> float:
    """Times steps and updates of an agent; returns the seconds of the whole run.

    The run's random numbers do not change.

    Args:
        learner: An :class:`~roboverse_learn.training.learners.AgentLearner` with ``brief`` settings.

    Returns:
        Seconds, at most the time limit of the run.
    """
    config = learner.config.train
    with cpu_threads(config.num_threads, learner.device), torch.random.fork_rng():
        env = learner.open_env(0)
        try:
            loop = Loop(learner.make_agent(env, 0), env, config, Path(), 0, Reporter())
            loop.begin(None)
            _advance(loop, 0.0)  # the first update is slower than those that follow
            per_step = _advance(loop, _LEAST_TIMED_S)
        finally:
            env.close()
    return _limited(per_step * config.steps, config)


def _advance(loop: Loop, least_s: float) -> float:
    """Advances until it has learned; returns the seconds of an environment step, the updates included."""
    start, first = time.perf_counter(), loop.step
    while True:
        updates = loop.updates
        loop.advance()
        seconds = time.perf_counter() - start
        if seconds >= (least_s if loop.updates > updates else _MOST_TIMED_S):
            return seconds / (loop.step - first)


def _limited(seconds: float, config: TrainConfig) -> float:
    return seconds if config.time_limit_s is None else min(seconds, config.time_limit_s)


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

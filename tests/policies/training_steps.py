"""A batch of raw frames, and gradient steps on it, for policies that read instructions."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch


def batch(policy: Any, n: int = 2) -> dict[str, torch.Tensor]:
    """Returns raw frames, as the dataset gives them."""
    rng, deltas, out = np.random.default_rng(0), policy.delta_indices, {}
    for key, shape in policy.shapes.items():
        time = (len(deltas[key]),) if key in deltas else ()
        if key in policy.image_keys:
            out[key] = torch.from_numpy(rng.integers(0, 256, (n, *time, *shape), np.uint8))
        else:
            out[key] = torch.from_numpy(rng.normal(size=(n, *time, *shape)).astype(np.float32))
        out |= {f"{key}_is_pad": torch.zeros(n, *time, dtype=torch.bool)} if time else {}
    return out | {"task_index": torch.arange(n)}


def steps(policy: Any, words: Sequence[str], lr: float = 1e-3, count: int = 1) -> list[float]:
    """Takes gradient steps on one batch; returns the losses."""
    from roboverse_learn.training.config import TrainConfig
    from roboverse_learn.training.imitation.optimizer import make_optimizer

    policy.instructions = words
    policy.begin_training()
    optimizer, objective, losses = make_optimizer(policy, TrainConfig(lr=lr)), policy.objective(), []
    for group in optimizer.param_groups:
        group["lr"] = group["peak_lr"]
    for _ in range(count):
        torch.manual_seed(0)
        loss, _ = objective(batch(policy))
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()
        losses.append(loss.item())
    policy.end_training()
    return losses

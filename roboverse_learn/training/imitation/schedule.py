"""The learning rate, as a function of how much of the training is done."""

import math

from roboverse_learn.training.config import TrainConfig


def progress(config: TrainConfig, step: int, elapsed_s: float) -> float:
    """Returns the share of training that is done, from 0 to 1.

    Args:
        config: Training configuration.
        step: Gradient steps taken.
        elapsed_s: Seconds of training, over all resumptions.
    """
    done = step / config.steps
    if config.time_limit_s is not None:
        done = max(done, elapsed_s / config.time_limit_s)
    return min(1.0, done)


def learning_rate_factor(config: TrainConfig, step: int, elapsed_s: float) -> float:
    """Returns what the peak learning rate is multiplied with: linear warm-up, then the schedule."""
    warmup = min(1.0, (step + 1) / config.warmup_steps) if config.warmup_steps else 1.0
    if config.schedule == "constant":
        return warmup
    return warmup * 0.5 * (1.0 + math.cos(math.pi * progress(config, step, elapsed_s)))

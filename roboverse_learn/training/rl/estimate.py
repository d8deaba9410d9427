"""How long learning in an env will take on this machine, measured."""

import time
from pathlib import Path
from typing import Any

import torch

from roboverse_learn.training.device import cpu_threads
from roboverse_learn.training.reporter import Reporter
from roboverse_learn.training.rl.loop import Loop

_LEAST_TIMED_S, _MOST_TIMED_S = 1.0, 20.0


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
    return config.limited_s(per_step * config.steps)


def _advance(loop: Loop, least_s: float) -> float:
    """Advances until it has learned; returns the seconds of an environment step, the updates included."""
    start, first = time.perf_counter(), loop.step
    while True:
        updates = loop.updates
        loop.advance()
        seconds = time.perf_counter() - start
        if seconds >= (least_s if loop.updates > updates else _MOST_TIMED_S):
            return seconds / (loop.step - first)

"""Measures how many attempts an augmentation keeps, and what a kept one costs, without rendering.

``python -m roboverse_learn.data.augmentation.check from=<dataset> episodes=100 expert=true`` makes attempts
in the first episodes of the train split that are no source's, and prints one line; another one for the task's
expert in the same episodes. Other keys are those of ``roboverse collect``, such as ``augment.choose=random``.
"""

import logging
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from envs.core.errors import ConfigError
from envs.experts.actor import expert_episodes
from envs.rollout import Episode
from envs.spec import EnvSpec
from roboverse_learn.data.augmentation.actor import augmented_episodes
from roboverse_learn.data.augmentation.planner import AugmentPlanner
from roboverse_learn.data.augmentation.sources import read_sources
from roboverse_learn.data.check_program import run_check

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, slots=True)
class AugmentReport:
    """Results of attempts.

    Attributes:
        attempts: Number of episodes tried.
        kept: How many succeeded.
        retried: How many of those began a subtask again.
        mean_steps: Mean number of control steps.
        cpu_s: CPU time of this process, of all attempts.
        failures: Episodes that failed.
    """

    attempts: int
    kept: int
    retried: int
    mean_steps: float
    cpu_s: float
    failures: tuple[int, ...]

    def __str__(self) -> str:
        """Returns one line."""
        return (
            f"{self.kept} of {self.attempts} kept ({100 * self.kept / self.attempts:.1f} %), "
            f"{self.cpu_s / max(self.kept, 1):.3f} CPU-s per success, {self.mean_steps:.0f} steps on "
            f"average, {self.retried} after a retry; failed: {', '.join(map(str, self.failures)) or 'none'}"
        )


def measure(episodes: Iterable[Episode]) -> AugmentReport:
    """Runs episodes and counts.

    Raises:
        ConfigError: There is no episode.
    """
    begun, steps, retried, failures = time.process_time(), [], 0, []
    for episode in episodes:
        steps.append(episode.length)
        if not episode.success:
            failures.append(episode.episode)
        retried += bool(episode.success and getattr(episode.memory, "retries", 0))
    if not steps:
        raise ConfigError("A measurement needs at least one episode: give episodes=100.")
    return AugmentReport(
        attempts=len(steps),
        kept=len(steps) - len(failures),
        retried=retried,
        mean_steps=sum(steps) / len(steps),
        cpu_s=time.process_time() - begun,
        failures=tuple(failures),
    )


def check_augmentation(config: Any, num_episodes: int, *, expert: bool) -> dict[str, AugmentReport]:
    """Measures an augmentation, and on request the task's expert in the same episodes.

    Args:
        config: Configuration of ``roboverse collect source=augment``.
        num_episodes: Number of attempts.
        expert: Whether to measure the expert too.
    """
    spec: EnvSpec = config.env
    env = spec.make(min(config.collect.num_envs, num_episodes), observation="state", num_threads=1)
    try:
        found = read_sources(config.from_dataset, env.task, config.augment)
        logger.info("%s", found)
        planner = AugmentPlanner(env.task, found.sources, config.augment)
        free = [index for index in env.split_indices.tolist() if index not in found.own_episodes]
        tried = free[:num_episodes]
        made = augmented_episodes(env, tried, planner, config.augment.retries, record=())
        reports = {"augment": measure(made)}
        if expert:
            reports["expert"] = measure(expert_episodes(env, tried, record=()))
        return reports
    finally:
        env.close()


def main(argv: Sequence[str] | None = None) -> int:
    """Measures and prints; returns the exit code."""
    return run_check(argv, "augment", {"episodes": "100", "expert": "false"}, _print_reports)


def _print_reports(config: Any, count: int, own: Mapping[str, str]) -> None:
    if own["expert"] not in ("true", "false"):
        raise ConfigError(f"expert={own['expert']}: give true or false.")
    for name, report in check_augmentation(config, count, expert=own["expert"] == "true").items():
        logger.info("%s, %s: %s", config.env.task, name, report)


if __name__ == "__main__":
    sys.exit(main())

"""Measures how often the expert succeeds, and how smoothly it moves.

``python -m envs.experts.check task=PickCube episodes=1000`` runs the expert in the first episodes of each
split, without rendering, and prints one line per split, with the episodes that it did not solve. What
listings and pages show is counted by ``python -m envs.experts.survey``.
"""

import logging
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from envs.core.arguments import parse
from envs.core.errors import ConfigError, RoboVerseError, unknown_name
from envs.experts.actor import expert_episodes
from envs.joint_readings import target_readings
from envs.randomization.splits import SPLIT_NAMES, SPLITS
from envs.rollout import Episode
from envs.spec import EnvSpec

logger = logging.getLogger(__name__)

_COMMAND = "python -m envs.experts.check"


@dataclass(frozen=True, slots=True)
class ExpertReport:
    """Results of the expert in some episodes.

    Attributes:
        num_episodes: Number of episodes.
        failures: Indices of those that were not solved, in the order in which they were run.
        mean_steps: Mean number of control steps, including those after success.
        largest_step_rad: Largest change of an arm joint's target from one control step to the next.
    """

    num_episodes: int
    failures: tuple[int, ...]
    mean_steps: float
    largest_step_rad: float

    @property
    def success_rate(self) -> float:
        """Share of episodes that were solved, in [0, 1]."""
        return 1.0 - len(self.failures) / self.num_episodes


def summarize(
    episodes: Iterable[Episode],
    arm: Sequence[int],
    positions: Callable[[np.ndarray], np.ndarray] = lambda actions: actions,
) -> ExpertReport:
    """Reduces episodes to a report.

    Args:
        episodes: At least one.
        arm: Columns of an action that are the arm's joints; fingers may jump.
        positions: Returns the targets, rad, of actions (T, A).

    Raises:
        ConfigError: There is no episode.
    """
    failures, steps, largest = [], [], 0.0
    for episode in episodes:
        steps.append(len(episode.actions))
        if not episode.success:
            failures.append(episode.episode)
        if not len(episode.actions):  # the expert gave up at once
            continue
        jumps = np.abs(np.diff(positions(episode.actions)[:, list(arm)], axis=0))
        largest = max(largest, float(jumps.max(initial=0.0)))
    if not steps:
        raise ConfigError("The expert's check needs at least one episode, given none.")
    return ExpertReport(len(steps), tuple(failures), float(np.mean(steps)), largest)


def check_expert(
    task: str,
    split: str,
    num_episodes: int,
    *,
    num_envs: int = 64,
    num_threads: int = 0,
    simulator: str = "mujoco",
    robot: str = "",
) -> ExpertReport:
    """Runs the expert in the first episodes of a split.

    Args:
        task: Name of a task.
        split: One of :data:`~envs.randomization.splits.SPLIT_NAMES`.
        num_episodes: Number of episodes; all of a split that has fewer.
        num_envs: Environments stepped at once; the result does not depend on it.
        num_threads: Threads of the simulator; 0 means one per core.
        simulator: Name of a simulator.
        robot: Robot that does the task; empty is the task's own.

    Raises:
        ConfigError: ``num_episodes`` is below 1.
    """
    if num_episodes < 1:
        raise ConfigError(f"The expert's check needs at least one episode, given {num_episodes}.")
    env = EnvSpec(task=task, simulator=simulator, robot=robot).make(
        min(num_envs, num_episodes), split=split, observation="state", num_threads=num_threads
    )
    try:
        robots = env.task.robots
        fingers = [robot.reading_names[column] for robot in robots for column in robot.fingers]
        fingers += [f"{robot.name}/{name}" for robot in robots for name in fingers]
        alone = target_readings(robots[0])
        in_rad = alone.positions if env.controller.names == alone.names else np.asarray
        arm = [column for column, name in enumerate(env.controller.names) if name not in fingers]
        episodes = env.split_indices[:num_episodes].tolist()
        return summarize(expert_episodes(env, episodes, record=()), arm, in_rad)
    finally:
        env.close()


@dataclass(frozen=True, kw_only=True, slots=True)
class CheckSettings:
    """Settings of the command.

    Attributes:
        task: Name of a task.
        episodes: Episodes of each split.
        split: ``train``, ``validation`` or ``test`` alone; the first and the last by default.
        num_envs: Environments stepped at once.
        simulator: Name of a simulator.
    """

    task: str = "PickCube"
    episodes: int = 1000
    split: str | None = None
    num_envs: int = 64
    simulator: str = "mujoco"


def main(argv: Sequence[str] | None = None) -> int:
    """Checks the expert on the train and the test split, or on one; returns the exit code."""
    words = sys.argv[1:] if argv is None else argv
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    try:
        settings = parse(_COMMAND, CheckSettings, words)
        if settings.split is not None and settings.split not in SPLIT_NAMES:
            raise unknown_name("split", settings.split, SPLIT_NAMES)
        for split in SPLITS if settings.split is None else (settings.split,):
            _check(settings, split)
    except RoboVerseError as error:
        logger.error("%s", error)
        return 2
    return 0


def _check(settings: CheckSettings, split: str) -> None:
    """Measures one split and logs the result."""
    report = check_expert(
        settings.task, split, settings.episodes, num_envs=settings.num_envs, simulator=settings.simulator
    )
    logger.info(
        "%s %s in %s: %.2f %% success (%d of %d episodes), %.1f steps on average, "
        "largest joint step %.3f rad; failed: %s",
        settings.task,
        split,
        settings.simulator,
        100.0 * report.success_rate,
        report.num_episodes - len(report.failures),
        report.num_episodes,
        report.mean_steps,
        report.largest_step_rad,
        ", ".join(map(str, report.failures)) or "none",
    )


if __name__ == "__main__":
    sys.exit(main())

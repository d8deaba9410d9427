"""Measures how often the expert succeeds, and how smoothly it moves.

``python -m envs.experts.check task=PickCube episodes=1000`` runs the expert in the first episodes of each
split, without rendering, and prints one line per split; ``record=true`` writes the result to
``envs/tasks/experts.json``, which listings and pages read.
"""

import logging
import shlex
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from envs.core.arguments import parse
from envs.core.errors import ConfigError, RoboVerseError, unknown_name
from envs.core.git import git_sha
from envs.experts.actor import expert_episodes
from envs.experts.record import RECORDS, ExpertRecord, SplitRecord, write_record
from envs.joint_readings import target_readings
from envs.randomization.splits import SPLITS
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

    @property
    def summary(self) -> SplitRecord:
        """The figures that are recorded."""
        return SplitRecord(self.num_episodes, round(self.success_rate, 4), round(self.mean_steps, 1))


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
        split: ``"train"`` or ``"test"``.
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
        split: ``train`` or ``test`` alone; both by default.
        num_envs: Environments stepped at once.
        simulator: Name of a simulator.
        record: Whether to write the result to ``records``.
        records: File of results.
    """

    task: str = "PickCube"
    episodes: int = 1000
    split: str | None = None
    num_envs: int = 64
    simulator: str = "mujoco"
    record: bool = False
    records: Path = RECORDS


def main(argv: Sequence[str] | None = None) -> int:
    """Checks the expert on both splits, or on one; returns the exit code."""
    words = sys.argv[1:] if argv is None else argv
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    try:
        settings = parse(_COMMAND, CheckSettings, words)
        if settings.split is not None and settings.split not in SPLITS:
            raise unknown_name("split", settings.split, SPLITS)
        if settings.record and settings.simulator != "mujoco":
            raise ConfigError(
                f"Records are measured in mujoco, given simulator={settings.simulator}. "
                "Leave out record=true."
            )
        splits = SPLITS if settings.split is None else (settings.split,)
        measured = {split: _check(settings, split) for split in splits}
        if settings.record:
            command = shlex.join([*_COMMAND.split(), *_public(words)])
            write_record(settings.task, ExpertRecord(measured, command, git_sha()), settings.records)
    except RoboVerseError as error:
        logger.error("%s", error)
        return 2
    return 0


def _check(settings: CheckSettings, split: str) -> SplitRecord:
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
    return report.summary


def _public(words: Sequence[str]) -> list[str]:
    """Returns the words of a command with paths reduced to file names."""
    pairs = (word.partition("=") for word in words)
    return [
        f"{key}={Path(value).name}" if value.startswith(("/", "~")) else f"{key}{equals}{value}"
        for key, equals, value in pairs
    ]


if __name__ == "__main__":
    sys.exit(main())

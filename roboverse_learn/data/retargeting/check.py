"""Measures how many demonstrations a retargeting keeps, and what one costs, without rendering.

``python -m roboverse_learn.data.retargeting.check from=<dataset> robots=iiwa,ur5e episodes=20`` follows the
first episodes of a dataset with each robot and prints a row of a table for each. Other keys are those of
``roboverse collect``, such as ``simulator=newton``.
"""

import logging
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from envs.core.arguments import read_list
from envs.core.errors import ConfigError
from envs.robots import ROBOTS
from roboverse_learn.data.check_program import run_check
from roboverse_learn.data.dataset.recorded_scene import recorded_spec
from roboverse_learn.data.dataset.recording import read_recordings
from roboverse_learn.data.retargeting.actor import retargeted_episodes
from roboverse_learn.data.retargeting.hand_path import HandPathReader
from roboverse_learn.data.retargeting.planner import RetargetPlanner
from roboverse_learn.data.sources.retarget import RetargetSource

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, slots=True)
class RetargetReport:
    """Results of one robot.

    Attributes:
        robot: Its name.
        attempts: Number of demonstrations that it followed.
        kept: How many solved the task.
        missed_m: Farthest that a pose of a hand path was missed by in any of them.
        cpu_s: CPU time of this process, of all of them.
        failures: Pool index of those that failed.
    """

    robot: str
    attempts: int
    kept: int
    missed_m: float
    cpu_s: float
    failures: tuple[int, ...]

    def __str__(self) -> str:
        """Returns a row of a table: robot, kept, CPU time of each, largest miss, failures."""
        cells = (
            f"{self.kept} of {self.attempts} ({100 * self.kept / self.attempts:.0f} %)",
            f"{self.cpu_s / self.attempts:.3f}",
            f"{1000 * self.missed_m:.1f}",
            ", ".join(map(str, self.failures)) or "none",
        )
        return f"| {self.robot} | {' | '.join(cells)} |"


def check_retargeting(config: Any, count: int) -> RetargetReport:
    """Measures one robot.

    Args:
        config: Configuration of ``roboverse collect source=retarget``.
        count: Number of demonstrations, from the first one on.
    """
    RetargetSource(config).check()
    recordings = read_recordings(config.from_dataset, count)
    indices = [int(recording.metadata["episode"]) for recording in recordings]
    reader = HandPathReader(recorded_spec(recordings[0].metadata).make_task().robot)
    env = config.env.make(min(config.collect.num_envs, len(indices)), observation="state", num_threads=1)
    try:
        planner = RetargetPlanner(env.task, at_once=env.handler.steps_together)
        begun = time.process_time()
        starts = [recording.states.select([0]) for recording in recordings]
        paths = [reader.read(recording.states) for recording in recordings]
        done = list(retargeted_episodes(env, indices, planner, starts, paths, record=()))
        return RetargetReport(
            robot=config.env.robot or env.task.robot.name,
            attempts=len(done),
            kept=sum(episode.success for episode in done),
            missed_m=max(episode.memory.missed_m for episode in done),
            cpu_s=time.process_time() - begun,
            failures=tuple(episode.episode for episode in done if not episode.success),
        )
    finally:
        env.close()


def main(argv: Sequence[str] | None = None) -> int:
    """Measures and prints; returns the exit code."""
    return run_check(argv, "retarget", {"episodes": "20", "robots": ""}, _print_table)


def _print_table(config: Any, count: int, own: Mapping[str, str]) -> None:
    robots = read_list("robots", own["robots"])
    if not robots:
        raise ConfigError("Name the robots that follow, as in robots=iiwa,ur5e.")
    for robot in robots:
        ROBOTS.entry(robot)  # before a table begins
    logger.info("| %s | kept | CPU-s each | largest miss, mm | failed |", config.env.task)
    logger.info("|---|---|---|---|---|")
    for robot in robots:
        one = replace(config, env=config.env.replace(robot=robot))
        logger.info("%s", check_retargeting(one, count))


if __name__ == "__main__":
    sys.exit(main())

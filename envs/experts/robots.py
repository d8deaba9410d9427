"""Measures how often the expert of each task succeeds on each robot: a table of robots and tasks.

``python -m envs.experts.robots`` runs the expert in the first episodes of the test split, without rendering,
and writes ``results/robots.json`` after every cell; run again, it measures what is missing. A robot that
cannot do a task is recorded with the reason. An arm whose asset folder is not here is left out.
"""

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from envs.core.arguments import run_program
from envs.core.atomic import write_json
from envs.core.errors import ConfigError, MissingAssetError
from envs.core.git import git_sha
from envs.core.json_file import read_kept
from envs.experts.check import check_expert
from envs.robots import ROBOTS
from envs.spec import EnvSpec
from envs.tasks import TASKS

logger = logging.getLogger(__name__)

_COMMAND = "python -m envs.experts.robots"
_SCHEMA = 1
SPLIT = "test"


@dataclass(frozen=True, kw_only=True, slots=True)
class RobotsSettings:
    """Settings of the command.

    Attributes:
        robots: Robots; empty takes all arms with a gripper.
        tasks: Tasks.
        episodes: Episodes of the test split, for each robot and task.
        num_envs: Environments stepped at once.
        num_threads: Threads of the simulator; 0 means one per core.
        out: File of the table.
    """

    robots: tuple[str, ...] = ()
    tasks: tuple[str, ...] = (
        *("PickCube", "StackCube", "CloseBox", "MoveSliderLeft", "PickChocolatePudding"),
        *("NutAssembly", "NutAssemblySquare"),
    )
    episodes: int = 50
    num_envs: int = 25
    num_threads: int = 0
    out: Path = Path("results/robots.json")


def measure(robot: str, task: str, settings: RobotsSettings) -> dict[str, Any]:
    """Returns one cell of the table: the place of the robot and the expert's success, or why it cannot."""
    try:
        placed = EnvSpec(task=task, robot=robot).make_task().robot
    except MissingAssetError:
        raise
    except ConfigError as error:
        return {"robot": robot, "task": task, "refused": str(error), "git_sha": git_sha()}
    own = EnvSpec(task=task).make_task().robot
    report = check_expert(
        task,
        SPLIT,
        settings.episodes,
        robot=robot,
        num_envs=settings.num_envs,
        num_threads=settings.num_threads,
    )
    return {
        "robot": robot,
        "task": task,
        "split": SPLIT,
        "num_episodes": report.num_episodes,
        "num_successes": report.num_episodes - len(report.failures),
        "failures": list(report.failures),
        "mean_steps": round(report.mean_steps, 1),
        "largest_step_rad": round(report.largest_step_rad, 3),
        "base_moved_m": [round(a - b, 3) + 0.0 for a, b in zip(placed.pos, own.pos, strict=True)],
        "git_sha": git_sha(),
    }


def read_table(path: Path) -> list[dict[str, Any]]:
    """Returns the cells of a table; none where there is no file.

    Raises:
        ConfigError: The file is damaged, or of another schema.
    """
    return read_kept(path, _cells, "is no table of robots", "Remove it, or give out=<file>.") or []


def _cells(document: dict[str, Any]) -> list[dict[str, Any]]:
    if document["schema_version"] != _SCHEMA:
        raise ValueError(f"its schema_version is {document['schema_version']}, not {_SCHEMA}")
    return list(document["cells"])


def as_text(cells: Sequence[dict[str, Any]]) -> str:
    """Returns a table as Markdown: a row per robot, a column per task."""
    tasks = list(dict.fromkeys(cell["task"] for cell in cells))
    found = {(cell["robot"], cell["task"]): _shown(cell) for cell in cells}
    rows = [
        [robot, *(found.get((robot, task), "") for task in tasks)]
        for robot in dict.fromkeys(cell["robot"] for cell in cells)
    ]
    lines = [["robot", *tasks], ["---"] * (len(tasks) + 1), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _shown(cell: dict[str, Any]) -> str:
    return "cannot" if "refused" in cell else f"{cell['num_successes']}/{cell['num_episodes']}"


def _is_done(cell: dict[str, Any], episodes: int) -> bool:
    return "refused" in cell or cell["num_episodes"] >= episodes


def main(words: Sequence[str] | None = None) -> int:
    """Completes the table; returns the exit code."""
    return run_program(_COMMAND, RobotsSettings, _complete, words)


def _complete(settings: RobotsSettings) -> None:
    robots = settings.robots or tuple(ROBOTS.names("arm"))
    for robot in robots:
        ROBOTS.entry(robot)
    for task in settings.tasks:
        TASKS.entry(task)
    cells = {(cell["robot"], cell["task"]): cell for cell in read_table(settings.out)}
    for task in settings.tasks:
        for robot in robots:
            if (robot, task) in cells and _is_done(cells[robot, task], settings.episodes):
                continue
            try:
                cells[robot, task] = measure(robot, task, settings)
            except MissingAssetError as error:
                if settings.robots:
                    raise
                logger.warning("%s %s is left out: %s", robot, task, error)
                continue
            settings.out.parent.mkdir(parents=True, exist_ok=True)
            ordered = [cells[key] for key in sorted(cells)]
            write_json(settings.out, {"schema_version": _SCHEMA, "command": _COMMAND, "cells": ordered})
            logger.info("%s %s: %s", robot, task, _shown(cells[robot, task]))
    logger.info("%s", as_text([cells[key] for key in sorted(cells)]))


if __name__ == "__main__":
    sys.exit(main())

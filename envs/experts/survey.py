"""Looks at many tasks in turn: each is made, started, held still, rendered, and its expert counted.

``python -m envs.experts.survey words=[libero,spatial]`` writes one row a task into ``results/tasks.json``.
Tasks that are there already are left out; ``again=true`` measures them again, ``episodes=0`` leaves the
expert out. Either way the same command continues where it was interrupted, and says at the end how long all
its pieces took. Without words it surveys every registered task; one whose files or packages are not on this
machine is left out with a warning. Listings and pages read the file: see :mod:`envs.experts.counts`.
"""

import json
import logging
import shlex
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock
from PIL import Image

from envs.core.arguments import run_program
from envs.core.atomic import write_file
from envs.core.errors import ConfigError, MissingAssetError, MissingExtraError, RoboVerseError
from envs.core.git import git_sha
from envs.experts.actor import expert_episodes
from envs.experts.counts import read_rows
from envs.experts.survey_progress import SurveyProgress, clocks
from envs.spec import EnvSpec
from envs.tasks import TASKS
from envs.vector_env import RoboVerseVectorEnv

logger = logging.getLogger(__name__)

_COMMAND = "python -m envs.experts.survey"

STILL_S = 1.0
"""Time for which the robot holds its posture."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SurveySettings:
    """Settings of the command.

    Attributes:
        words: Words that a task's name has, all of them.
        tasks: Registered names, of which those are surveyed that have the words; all by default.
        episodes: Starts that its expert is counted in, of the test split; 0 counts none.
        num_envs: Environments stepped at once.
        results: File of results.
        images: Folder of images of the starts; none are rendered without it.
        image_size: Pixels along their sides.
        again: Measure tasks that are in the file already, except for what this command measured before it was
            interrupted.
    """

    words: tuple[str, ...] = ()
    tasks: tuple[str, ...] = ()
    episodes: int = 20
    num_envs: int = 4
    results: Path = Path("results/tasks.json")
    images: str = ""
    image_size: int = 256
    again: bool = False


def main(words: Sequence[str] | None = None) -> int:
    """Surveys the tasks that have the words; returns the exit code."""
    given = sys.argv[1:] if words is None else words
    command = shlex.join([*_COMMAND.split(), *_public(given)])
    return run_program(_COMMAND, SurveySettings, lambda settings: _survey_all(settings, command), given)


def _survey_all(settings: SurveySettings, command: str) -> int:
    """Surveys the tasks that have the words; returns 1 where one failed."""
    named = [TASKS.entry(name).name for name in settings.tasks] or list(TASKS)
    names = [name for name in named if all(word.lower() in name.lower() for word in settings.words)]
    if not names:
        raise ConfigError(f"No task has the words {' and '.join(settings.words)} in its name.")
    failed, sha = 0, git_sha()
    progress = SurveyProgress.of(settings.results, command, sha)
    for place, name in enumerate(names, 1):
        kept = read_rows(settings.results).get(name)
        if name in progress.done if settings.again else _is_done(kept, settings):
            continue
        began = clocks()
        try:
            row = survey(name, settings)
        except (MissingAssetError, MissingExtraError) as error:
            logger.warning(
                "%d/%d %s is left out, for it cannot be made here: %s", place, len(names), name, error
            )
            continue
        except RoboVerseError as error:  # the others go on without it, and the row says why
            row, failed = {"error": str(error)}, failed + 1
        _write_row(settings.results, name, {**row, "command": command, "git_sha": sha})
        if "error" not in row:
            progress.add(name, began, settings.results)
        logger.info("%d/%d %s: %s", place, len(names), name, json.dumps(row))
    progress.finish(settings.results)
    return 1 if failed else 0


def _write_row(results: Path, name: str, row: dict[str, Any]) -> None:
    """Writes the row of one task; surveys of other tasks may write theirs at the same time.

    An earlier error is over. Earlier counts stay where there are no new ones, with the command and commit
    that counted them.
    """
    results.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(results.with_name(f".{results.name}.lock")):
        rows = read_rows(results)
        old = {key: value for key, value in rows.get(name, {}).items() if key != "error"}
        if "expert" in old and "expert" not in row:
            row = {key: value for key, value in row.items() if key not in ("command", "git_sha")}
        rows[name] = {**old, **row}
        text = json.dumps({key: rows[key] for key in sorted(rows)}, indent=1) + "\n"
        write_file(results, text.encode())


def _public(words: Sequence[str]) -> list[str]:
    """Returns the words of a command with paths of this machine reduced to file names."""
    pairs = (word.partition("=") for word in words)
    return [
        f"{key}={Path(value).name}" if value.startswith(("/", "~")) else f"{key}{equals}{value}"
        for key, equals, value in pairs
    ]


def _is_done(row: dict[str, Any] | None, settings: SurveySettings) -> bool:
    if row is None or "error" in row:
        return False
    wants_image = bool(settings.images) and not row.get("rendered")
    has_none = "expert" in row and row["expert"] is None
    return (has_none or row.get("episodes", 0) >= settings.episodes) and not wants_image


def survey(name: str, settings: SurveySettings) -> dict[str, Any]:
    """Returns the facts of one task: whether it loads, keeps still and renders, and its expert's count."""
    began = time.perf_counter()
    observation = "pixels" if settings.images else "state"
    spec = EnvSpec(task=name, image_size=settings.image_size)
    env = spec.make(max(1, min(settings.num_envs, settings.episodes)), split="test", observation=observation)
    try:
        row: dict[str, Any] = {"make_s": round(time.perf_counter() - began, 2), **_stillness(env)}
        if settings.images:
            env.reset_envs([0], env.split_indices[:1])
            image = env.image(0)
            path = Path(settings.images) / f"{name.replace('/', '-')}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(image).save(path)
            row["rendered"] = bool(image.std() > 1.0)
        if settings.episodes:
            row |= _expert_count(env, settings.episodes) if env.task.has_expert else {"expert": None}
        return row
    finally:
        env.close()


def _stillness(env: RoboVerseVectorEnv) -> dict[str, Any]:
    """Returns whether a start is solved already, and how far anything moves then while the robot holds still.

    What its fingers hold may fall then: they stay where they are and no longer press.
    """
    ids = np.arange(env.num_envs)
    env.reset_envs(ids, env.split_indices[: env.num_envs])
    before = env.get_states()
    solved = bool(env.task.success(before).any())
    hold = env.controller.hold(before)
    for _ in range(round(STILL_S * env.control_hz)):
        env.step_envs(ids, hold)
    after = env.get_states()
    moved = {
        name: float((after.objects[name].pos - entity.pos).norm(dim=-1).max())
        for name, entity in before.objects.items()
    }
    worst = max(moved, key=lambda key: moved[key], default="")
    return {"moved_m": round(moved.get(worst, 0.0), 4), "moved": worst, "solved_at_start": solved}


def _expert_count(env: RoboVerseVectorEnv, count: int) -> dict[str, Any]:
    began = time.perf_counter()
    episodes = list(expert_episodes(env, env.split_indices[:count].tolist(), record=()))
    solved = [episode.success for episode in episodes]
    return {
        "episodes": len(solved),
        "expert": round(sum(solved) / len(solved), 3),
        "mean_steps": round(float(np.mean([episode.length for episode in episodes])), 1),
        "episode_s": round((time.perf_counter() - began) / len(solved), 2),
    }


if __name__ == "__main__":
    sys.exit(main())

"""What a survey has measured in all its pieces, and the time they took.

It is kept beside the results until the survey is complete, under the command that began it, so that one that
was killed goes on. Another commit begins anew: an expert may have changed.
"""

import dataclasses
import hashlib
import json
import logging
import os
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from envs.core.atomic import write_file
from envs.core.json_file import read_kept

logger = logging.getLogger(__name__)


@dataclass(slots=True)
class SurveyProgress:
    """A survey that is under way.

    Attributes:
        command: The command, without paths of this machine.
        git_sha: The commit whose code measures.
        done: Tasks that were measured.
        pieces: How often the command was started.
        wall_s: Wall time of what was measured.
        cpu_s: CPU time of it, of all cores.
    """

    command: str
    git_sha: str | None
    done: list[str] = field(default_factory=list)
    pieces: int = 0
    wall_s: float = 0.0
    cpu_s: float = 0.0

    @classmethod
    def of(cls, results: Path, command: str, git_sha: str | None) -> Self:
        """Returns where a command left off, or a new beginning.

        Raises:
            ConfigError: The file is damaged.
        """
        path = _path(results, command)
        kept = read_kept(path, lambda values: cls(**values), "is no progress of a survey", "Remove it.")
        if kept is not None and kept.git_sha != git_sha:
            logger.info("What commit %s measured does not count: this is %s.", kept.git_sha, git_sha)
            kept = None
        found = cls(command, git_sha) if kept is None else kept
        return dataclasses.replace(found, pieces=found.pieces + 1)

    def add(self, name: str, began: tuple[float, float], results: Path) -> None:
        """Adds a task that was measured since a time of :func:`clocks`, and writes the file."""
        wall_s, cpu_s = clocks()
        self.done.append(name)
        self.wall_s += wall_s - began[0]
        self.cpu_s += cpu_s - began[1]
        write_file(_path(results, self.command), json.dumps(dataclasses.asdict(self), indent=1).encode())

    def finish(self, results: Path) -> None:
        """Reports the times of all pieces, and removes the file."""
        if self.done:
            started = "once" if self.pieces == 1 else f"{self.pieces} times"
            logger.info(
                "Measured %d tasks in %.1f min of wall time, %.1f min of CPU time; started %s.",
                *(len(self.done), self.wall_s / 60, self.cpu_s / 60, started),
            )
        _path(results, self.command).unlink(missing_ok=True)


def clocks() -> tuple[float, float]:
    """Returns wall and CPU time, s, the second of all threads and of processes that are over."""
    return time.perf_counter(), sum(os.times()[:4])


def _path(results: Path, command: str) -> Path:
    digest = hashlib.sha256(command.encode()).hexdigest()[:8]
    return results.with_name(f".{results.name}.{digest}.survey.json")

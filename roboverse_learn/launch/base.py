"""Interface of a launcher, and what it runs."""

import shlex
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar


@dataclass(frozen=True, slots=True)
class Job:
    """One process of a sweep.

    Attributes:
        name: Unique among the jobs of a sweep; a part of file names.
        words: Command and its ``key=value`` words.
        after: The job that must have succeeded before, or None. It comes earlier in the sweep.
    """

    name: str
    words: tuple[str, ...]
    after: str | None = None

    @property
    def command(self) -> str:
        """What a user would type."""
        return shlex.join(["roboverse", *self.words])

    @property
    def program(self) -> list[str]:
        """The same by this Python, wherever the process starts."""
        return [sys.executable, "-m", "roboverse_learn.cli", *self.words]


OnEnd = Callable[[Job, int | None], None]
"""Is called with every job that ended and its exit code, or None where the job before it failed."""


@dataclass(frozen=True, kw_only=True, slots=True)
class NoSettings:
    """A launcher without settings."""


class Launcher(ABC):
    """Runs the jobs of a sweep somewhere.

    A job is a command that writes to the folders it is given, ends at once where its work is done, and
    resumes where it was interrupted. A launcher may therefore start one again, and need not know what it
    computes.

    Args:
        settings: An instance of ``settings_class``.
        jobs_per_gpu: Processes that share a GPU.

    Attributes:
        settings_class: Frozen dataclass whose fields, all with defaults, are the keys of
            ``launcher_settings.*``. It checks their values.

    Raises:
        ConfigError: if a subclass cannot do what is asked for.
    """

    settings_class: ClassVar[type] = NoSettings

    def __init__(self, settings: Any, jobs_per_gpu: int = 1) -> None:
        self.settings, self.jobs_per_gpu = settings, jobs_per_gpu

    @abstractmethod
    def run(self, jobs: Sequence[Job], logs: Path, on_end: OnEnd) -> dict[str, int | None]:
        """Runs jobs, each after the one that it waits for, and returns when all have ended.

        Args:
            jobs: What to run, the most urgent first.
            logs: Folder that exists; a process appends what it prints to ``<name>.log`` in it.
            on_end: Is called once for each job, from one thread.

        Returns:
            Exit code by name; None of those whose predecessor failed.

        Raises:
            ConfigError: if nothing can be run from here.
        """

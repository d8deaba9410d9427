"""What the commands return to a program; :mod:`roboverse_learn.commands.report` prints it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from benchmark.records import Result
    from roboverse_learn.data.collection.collect import CollectionSummary
    from roboverse_learn.training.reporter import TrainResult


@dataclass(frozen=True, kw_only=True, slots=True)
class Evaluation:
    """Result of an evaluation.

    Attributes:
        path: The results file; None for a policy that is no checkpoint.
        result: What it holds.
        videos: Videos of the test split.
        reused: The file of an earlier evaluation of the same checkpoint stood for this one.
    """

    path: Path | None
    result: "Result"
    videos: tuple[Path, ...]
    reused: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainedRun:
    """Outcome of the whole loop.

    Attributes:
        folder: The run's folder.
        dataset: What was collected, a sentence on a dataset that was given, or None for a policy that
            learned from an environment.
        trained: What training did, its checkpoint among it.
        evaluations: One per task; none where the policy cannot act in the task.
        board: Files of the leaderboard; none where it could not be written.
        board_failure: Why it could not and what to do then, or empty.
        gif: Moving image of the policy, or None.
        note: Why nothing was evaluated, or empty.
        stages: Facts of each stage, by name.
        seconds: Wall time.
    """

    folder: Path
    dataset: "CollectionSummary | str | None"
    trained: "TrainResult"
    evaluations: tuple[Evaluation, ...]
    board: Mapping[str, Path]
    board_failure: str = ""
    gif: Path | None = None
    note: str = ""
    stages: Mapping[str, Any]
    seconds: float

    @property
    def checkpoint(self) -> Path:
        """Folder of the last checkpoint."""
        return self.trained.checkpoint

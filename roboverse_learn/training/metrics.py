"""Metrics writers of a run: always a JSON-lines file and TensorBoard, W&B on request."""

import contextlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from envs.core.atomic import write_file
from envs.core.errors import ConfigError, MissingExtraError

if TYPE_CHECKING:
    from roboverse_learn.training.config import TrainConfig

METRICS_FILE = "metrics.jsonl"

type Row = Mapping[str, float]


class MetricsWriter(Protocol):
    """Takes one row of numbers per logged step."""

    def write(self, step: int, row: Row) -> None:
        """Takes the numbers of a step."""
        ...

    def close(self) -> None:
        """Writes what is still held back."""
        ...


class JsonlWriter:
    """``metrics.jsonl``: one JSON object per logged step.

    A line is one write of an append-only file, so that a killed run leaves at most one incomplete
    line, which reading leaves out.

    Args:
        run_dir: Folder of the run.
        first_step: Rows from this step on are dropped: a resumed run computes them again.
    """

    def __init__(self, run_dir: Path, first_step: int = 0) -> None:
        path = run_dir / METRICS_FILE
        rows = [row for row in read_metrics(run_dir) if row["step"] <= first_step]
        write_file(path, "".join(json.dumps(row) + "\n" for row in rows).encode())
        self._descriptor = os.open(path, os.O_WRONLY | os.O_APPEND)

    def write(self, step: int, row: Row) -> None:
        """Appends one line."""
        os.write(self._descriptor, (json.dumps({"step": step, **row}) + "\n").encode())

    def close(self) -> None:
        """Flushes the file to the disk."""
        os.fsync(self._descriptor)
        os.close(self._descriptor)


class TensorBoardWriter:
    """Event files in ``tensorboard/``.

    Args:
        run_dir: Folder of the run.
        first_step: Earlier events from this step on are hidden: a resumed run computes them again.
    """

    def __init__(self, run_dir: Path, first_step: int = 0) -> None:
        from torch.utils.tensorboard import SummaryWriter

        purge = first_step + 1 if first_step else None
        self._writer = SummaryWriter(str(run_dir / "tensorboard"), purge_step=purge)

    def write(self, step: int, row: Row) -> None:
        """Adds one point to every curve."""
        for name, value in row.items():
            self._writer.add_scalar(f"train/{name}", value, step)

    def close(self) -> None:
        """Flushes the event file."""
        self._writer.close()


class WandbWriter:
    """A Weights & Biases run, continued when the training is.

    Args:
        run_dir: Folder of the run; its name is the run's name.
        settings: Configuration to record.

    Raises:
        MissingExtraError: if the package is not installed.
        ConfigError: if there is no login, or the server refuses the run or cannot be reached.
    """

    def __init__(self, run_dir: Path, settings: Mapping[str, Any]) -> None:
        with _wandb() as wandb:
            self._run = wandb.init(
                project="roboverse-learn",
                name=run_dir.name,
                id=run_dir.name,
                resume="allow",
                dir=str(run_dir),
                config=dict(settings),
            )

    def write(self, step: int, row: Row) -> None:
        """Logs one row."""
        self._run.log({f"train/{name}": value for name, value in row.items()}, step=step)

    def close(self) -> None:
        """Finishes the run."""
        self._run.finish()


def check_wandb() -> None:
    """Makes sure, before anything is computed, that a run can be logged to Weights & Biases.

    On a terminal it prompts for a missing key. It does nothing where ``WANDB_MODE`` needs no login.

    Raises:
        MissingExtraError: if the package is not installed.
        ConfigError: if there is no login.
    """
    with _wandb() as wandb:
        if os.environ.get("WANDB_MODE", "online") in ("online", "shared"):
            wandb.login()


@contextlib.contextmanager
def _wandb() -> Iterator[Any]:
    """Yields the package, and says what to do about its errors."""
    try:
        import wandb
    except ImportError as error:
        raise MissingExtraError(
            "train.wandb=true needs the package 'wandb', which is not installed. "
            "Install it with: pip install wandb. TensorBoard is written without it."
        ) from error
    try:
        yield wandb
    except wandb.Error as error:
        raise ConfigError(
            f"train.wandb=true, and Weights & Biases says: {' '.join(str(error).split())} Run `wandb login`, "
            "or set WANDB_MODE=offline, or leave it out with train.wandb=false: TensorBoard is written all "
            "the same."
        ) from error


def read_metrics(run_dir: Path) -> list[dict[str, float]]:
    """Returns the rows of ``metrics.jsonl``, oldest first; an incomplete last line is left out."""
    path = run_dir / METRICS_FILE
    if not path.is_file():
        return []
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            break
    return rows


def open_writers(run_dir: Path, first_step: int, config: "TrainConfig", policy: str) -> list[MetricsWriter]:
    """Opens the writers that a run's configuration names.

    Args:
        run_dir: Folder of the run.
        first_step: Step that the run starts at; see :class:`JsonlWriter`.
        config: How the run trains.
        policy: Name of its policy.
    """
    writers: list[MetricsWriter] = [JsonlWriter(run_dir, first_step), TensorBoardWriter(run_dir, first_step)]
    if config.wandb:
        writers.append(WandbWriter(run_dir, asdict(config) | {"policy": policy}))
    return writers


def plot_training(run_dir: Path, policy: str) -> Path | None:
    """Draws the losses of a run to ``losses.png``; returns its path, or None if nothing was logged."""
    from benchmark.leaderboard.plots import plot_losses

    rows = [row for row in read_metrics(run_dir) if "loss" in row]
    if not rows:
        return None
    path = run_dir / "losses.png"
    plot_losses(rows, path, title=f"Training of {policy}")
    return path

"""Learning curves: return and success over environment steps, of a run and over the seeds of a method.

A run's curve is ``<run>/curve.csv``, beside its results file.
"""

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.results import video_dir
from envs.core.atomic import write_file
from envs.core.errors import ResultError

COLUMNS = ("step", "elapsed_s", "episode_return", "success_rate")
"""Environment steps of all environments; seconds of training; means of the episodes since the last row."""

MEASURES = COLUMNS[2:]

_POINTS = 60
_RESAMPLES = 2000


def curve_path(result: Path) -> Path:
    """Returns where the learning curve of a results file is."""
    return video_dir(result) / "curve.csv"


def write_curve(result: Path, rows: Sequence[Mapping[str, float]]) -> Path | None:
    """Writes the learning curve that belongs to a results file.

    Args:
        result: The results file.
        rows: What was logged in training; rows in which no episode ended are left out.

    Returns:
        The file, or None when there is nothing to write.

    Raises:
        WriteError: The file cannot be written.
    """
    kept = [row for row in rows if all(math.isfinite(row.get(name, math.nan)) for name in COLUMNS)]
    if not kept:
        return None
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([[f"{row[name]:.8g}" for name in COLUMNS] for row in kept])
    path = curve_path(result)
    write_file(path, text.getvalue().encode())
    return path


def read_curve(result: Path) -> np.ndarray | None:
    """Returns the learning curve of a results file, (rows, 4) as in :data:`COLUMNS`; None if it has none.

    Raises:
        ResultError: The file is no learning curve.
    """
    path = curve_path(result)
    if not path.is_file():
        return None
    try:
        head, *rows = csv.reader(path.read_text(encoding="utf-8").splitlines())
        values = np.array([[float(cell) for cell in row] for row in rows])
    except ValueError as error:
        raise _broken(path, str(error)) from None
    if tuple(head) != COLUMNS or values.ndim != 2 or not np.isfinite(values).all():
        raise _broken(path, f"its head is {','.join(head)}")
    if values.shape[1] != len(COLUMNS):
        raise _broken(path, f"its rows have {values.shape[1]} numbers")
    if (np.diff(values[:, 0]) <= 0).any():
        raise _broken(path, "its steps do not increase")
    return values


def _broken(path: Path, reason: str) -> ResultError:
    return ResultError(
        f"'{path}' is no learning curve ({reason}); its head is {','.join(COLUMNS)}. Evaluate the run "
        "again, or remove the file."
    )


def over_seeds(curves: Sequence[np.ndarray], *, num_points: int = _POINTS) -> dict[str, Any]:
    """Returns the interquartile mean over runs, with its 95 % bootstrap interval, at common steps.

    Runs are resampled (rliable, arXiv:2108.13264, §4.3); one run has no interval. With fewer than four
    runs nothing is cut off, and the interquartile mean is the mean.

    Args:
        curves: Of every run, from :func:`read_curve`.
        num_points: Steps at which the curves are compared, evenly from the latest first to the earliest
            last one.

    Returns:
        ``steps``; ``seconds``, the mean over the runs; and for each of :data:`MEASURES` its ``mid``, ``low``
        and ``high``, of which the last two are None for one run.

    Raises:
        ValueError: There are no curves, or they have no steps in common.
    """
    if not curves:
        raise ValueError("A curve over seeds needs at least one run.")
    first, last = max(curve[0, 0] for curve in curves), min(curve[-1, 0] for curve in curves)
    if first > last:
        raise ValueError(
            f"The runs have no steps in common: the latest begins at {first}, one ends at {last}."
        )
    steps = np.linspace(first, last, num_points if last > first else 1)

    def column(index: int) -> np.ndarray:
        return np.stack([np.interp(steps, curve[:, 0], curve[:, index]) for curve in curves])

    found: dict[str, Any] = {
        "steps": steps.round().astype(int).tolist(),
        "seconds": column(1).mean(axis=0).tolist(),
    }
    for index, name in enumerate(MEASURES, start=2):
        low, mid, high = _iqm_with_interval(column(index))
        found[name] = {"mid": mid, "low": low, "high": high}
    return found


def _iqm_with_interval(values: np.ndarray) -> tuple[list[float] | None, list[float], list[float] | None]:
    """Returns the lower end, the interquartile mean over runs (R, P), and the upper end, (P,) each."""
    from scipy.stats import bootstrap, trim_mean

    def statistic(sample: np.ndarray, axis: int = -1) -> np.ndarray:
        return trim_mean(sample, 0.25, axis=axis)

    mid = statistic(values, axis=0)
    if len(values) < 2:
        return None, mid.tolist(), None
    interval = bootstrap(
        (values,),
        statistic,
        axis=0,
        vectorized=True,
        method="percentile",
        n_resamples=_RESAMPLES,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return interval.low.tolist(), mid.tolist(), interval.high.tolist()


def published(task: str) -> list[dict[str, Any]]:
    """Returns published reinforcement learning results of a task: method, steps, return, source."""
    return _reference("rows", task)


def published_times(task: str) -> list[dict[str, Any]]:
    """Returns how soon others published that a return was reached.

    Each has ``method``, ``reaches`` (the return), ``minutes``, ``steps``, ``machine``, ``robot`` and
    ``source``.
    """
    return _reference("times", task)


def _reference(kind: str, task: str) -> list[dict[str, Any]]:
    content = json.loads(files("benchmark").joinpath("reference/learning.json").read_text(encoding="utf-8"))
    return [row for row in content[kind] if row["task"] == task]

"""The harness of all speed programs: two sides timed in turns, one table, one exit code.

A time says as much about the machine as about the code. So every figure is the ratio of two times that are
taken in turns in one process.
"""

import logging
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from envs.core.arguments import run_program
from envs.core.atomic import write_json
from envs.core.errors import MissingExtraError, RoboVerseError, unknown_name
from envs.core.machine import use_one_core

log = logging.getLogger(__name__)

type Call = Callable[[], object]

HEADER = ("measurement", "ours", "baseline", "ratio", "goal", "result")


@dataclass(frozen=True, slots=True)
class Goal:
    """The bound of a measurement.

    Attributes:
        limit: The bound itself; None reports the ratio without a goal.
        at_least: True for a speed-up, baseline over ours, which has to reach the limit; False for an
            overhead, ours over baseline, which must not exceed it.
        applies: Whether it decides the exit code here: goals of a GPU do not apply on a CPU.
        absolute: The limit is in seconds of our side, and not a ratio.
    """

    limit: float | None = None
    at_least: bool = True
    applies: bool = field(default=True, kw_only=True)
    absolute: bool = field(default=False, kw_only=True)

    def __str__(self) -> str:
        if self.limit is None:
            return "-"
        unit, where = " s" if self.absolute else "", "" if self.applies else " on a GPU"
        return f"{'≥' if self.at_least else '≤'} {self.limit:.2f}{unit}{where}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Measurement:
    """Two times of one run.

    Attributes:
        name: What was compared.
        ours_s: Median time of our side, seconds.
        baseline_s: Median time of the baseline, seconds.
        ratio: Median over the turns: baseline over ours for a speed-up, ours over baseline for an overhead.
        goal: What the ratio is held against.
    """

    name: str
    ours_s: float
    baseline_s: float
    ratio: float
    goal: Goal

    @property
    def result(self) -> str:
        """``reached``, ``missed``, or ``-`` without a goal that applies."""
        goal = self.goal
        if goal.limit is None or not goal.applies:
            return "-"
        value = self.ours_s if goal.absolute else self.ratio
        return "reached" if (value >= goal.limit if goal.at_least else value <= goal.limit) else "missed"


def in_turns(
    ours: Call,
    baseline: Call,
    turns: int,
    *,
    clock: Callable[[], float] = time.perf_counter,
    before: Call | None = None,
    after: Call | None = None,
    wait: Call | None = None,
) -> np.ndarray:
    """Times two calls alternately, so that a machine that slows down slows both.

    The side that runs first alternates. One more turn, whose times are dropped, warms both up; the baseline
    runs first in it.

    Args:
        ours: Our side.
        baseline: What it is compared with.
        turns: How often each is timed.
        clock: Returns seconds.
        before: Called before every turn, not timed.
        after: Called after every turn, not timed, such as a check that both computed the same.
        wait: Waits for what was launched, before and after each call.

    Returns:
        Seconds of ours and of the baseline, (turns, 2).
    """
    seconds = np.zeros((turns + 1, 2))
    pause = wait or (lambda: None)
    for turn in range(turns + 1):
        if before is not None:
            before()
        for side in ((1, 0), (0, 1))[turn % 2]:
            pause()
            started = clock()
            (ours, baseline)[side]()
            pause()
            seconds[turn, side] = clock() - started
        if after is not None:
            after()
    return seconds[1:]


def measurement(name: str, seconds: np.ndarray, goal: Goal, *, units: int = 1) -> Measurement:
    """Returns the medians of the times of :func:`in_turns`.

    Args:
        name: What was compared.
        seconds: Times of ours and of the baseline, (turns, 2).
        goal: Its direction decides which ratio is meant.
        units: Steps, frames or images of one call; the times are those of one.
    """
    ours, baseline = seconds.T / units
    ratios = baseline / ours if goal.at_least and not goal.absolute else ours / baseline
    return Measurement(
        name=name,
        ours_s=float(np.median(ours)),
        baseline_s=float(np.median(baseline)),
        ratio=float(np.median(ratios)),
        goal=goal,
    )


def repeat(call: Call, count: int) -> Call:
    """Returns a call that makes ``count`` calls."""

    def run() -> None:
        for _ in range(count):
            call()

    return run


def cuda_wait(device: str) -> Call | None:
    """Returns what waits for the kernels of a Torch device; None on a CPU."""
    import torch

    return torch.cuda.synchronize if device.startswith("cuda") else None


@dataclass(frozen=True, kw_only=True, slots=True)
class Settings:
    """Settings of every speed program.

    Attributes:
        parts: What is measured, as in parts=[a,b]; all parts by default.
        out: JSON file for the measurements, written anew after each; none by default.
    """

    parts: tuple[str, ...] = ()
    out: Path | None = None


def program[S: Settings](
    name: str,
    settings_class: type[S],
    parts: Callable[[S], Mapping[str, Callable[[], Measurement]]],
    words: Sequence[str] | None = None,
    *,
    one_core: bool = False,
    environment: Mapping[str, str] | None = None,
) -> int:
    """Runs a speed program: reads its settings, measures its parts, prints one table.

    Args:
        name: Of the program, as in ``roboverse speed <name>``.
        settings_class: Settings that its ``key=value`` words give.
        parts: Returns the measurements by name; each is called once.
        words: The words; those of this process by default.
        one_core: Run on one core.
        environment: Environment variables, where they are not set already.

    Returns:
        1 if a goal is missed, a part failed or nothing was measured; 2 for wrong settings; else 0. A part
        whose optional package is absent is reported as not measured.
    """

    def run(settings: S) -> int:
        logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
        for key, value in (environment or {}).items():
            os.environ.setdefault(key, value)
        if one_core:
            use_one_core()
        available = parts(settings)
        for part in settings.parts:
            if part not in available:
                raise unknown_name(f"part of speed {name}", part, available)
        rows, failed = list[Row](), False
        for part in settings.parts or available:
            row, broken = _measure(part, available[part])
            failed |= broken
            rows.append(row)
            sys.stderr.write(f"{'  '.join(_cells(row))}\n")  # now: the rest may take minutes
            if settings.out is not None:
                settings.out.parent.mkdir(parents=True, exist_ok=True)
                write_json(settings.out, {"program": name, "rows": [_record(row) for row in rows]})
        sys.stdout.write(table(rows))
        results = [row.result for row in rows if isinstance(row, Measurement)]
        return int(failed or "missed" in results or not results)

    return run_program(f"roboverse speed {name}", settings_class, run, words)


type Row = Measurement | tuple[str, str]
"""A measurement, or the name of a part that was not measured and the reason."""


def _measure(part: str, measure: Callable[[], Measurement]) -> tuple[Row, bool]:
    """Returns the row of a part, and whether it failed."""
    try:
        return measure(), False
    except RoboVerseError as error:
        return (part, str(error)), not isinstance(error, MissingExtraError)


def table(rows: Sequence[Row]) -> str:
    """Returns the aligned table of all rows."""
    cells = [HEADER, *(_cells(row) for row in rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(HEADER) - 1)]
    lines = []
    for name, *rest, result in cells:
        middle = (text.rjust(width) for text, width in zip(rest, widths[1:], strict=True))
        lines.append("  ".join((name.ljust(widths[0]), *middle, result)) + "\n")
    return "".join(lines)


def _cells(row: Row) -> tuple[str, ...]:
    if isinstance(row, tuple):
        return (row[0], "-", "-", "-", "-", f"not measured: {row[1]}")
    times = (_time(row.ours_s), _time(row.baseline_s))
    return (row.name, *times, f"{row.ratio:.2f}", str(row.goal), row.result)


def _time(seconds: float) -> str:
    scale, unit = next(
        ((scale, unit) for scale, unit in ((1.0, "s"), (1e3, "ms")) if seconds * scale >= 1.0), (1e6, "µs")
    )
    return f"{seconds * scale:.3g} {unit}" if seconds * scale < 1000 else f"{seconds * scale:.0f} {unit}"


def _record(row: Row) -> dict[str, Any]:
    if isinstance(row, tuple):
        return {"name": row[0], "not_measured": row[1]}
    return asdict(row) | {"result": row.result}

"""The harness of all speed programs: two sides timed in turns, one table, one exit code.

A time says as much about the machine as about the code. So every figure is the ratio of two times that are
taken in turns in one process.
"""

import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Self, override

import numpy as np

from envs.core.arguments import run_program
from envs.core.atomic import write_json
from envs.core.errors import MissingExtraError, RoboVerseError, SimulatorError, unknown_name
from envs.core.machine import use_one_core
from envs.core.ranges import check_ranges

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


NO_GOAL = Goal()


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


def nothing() -> None:
    """Does nothing."""


def compare(
    name: str,
    ours: Call,
    baseline: Call,
    goal: Goal = NO_GOAL,
    *,
    turns: int,
    calls: int = 1,
    units: int = 1,
    device: str = "cpu",
    clock: Callable[[], float] = time.perf_counter,
    before: Call = nothing,
    after: Call = nothing,
) -> Measurement:
    """Times two calls alternately, so that a machine that slows down slows both.

    The side that runs first alternates. One more turn, whose times are dropped, warms both up; the baseline
    runs first in it.

    Args:
        name: What is compared.
        ours: Our side.
        baseline: What it is compared with.
        goal: What the ratio is held against.
        turns: How often each is timed.
        calls: Calls of each side in a turn.
        units: Steps, frames or images of one call; the times are those of one.
        device: Torch device, whose kernels are waited for.
        clock: Returns seconds.
        before: Called before every turn, not timed.
        after: Called after every turn, not timed, such as a check that both computed the same.
    """
    seconds = np.zeros((turns + 1, 2))
    wait = cuda_wait(device)
    for turn in range(turns + 1):
        before()
        for side in ((1, 0), (0, 1))[turn % 2]:
            seconds[turn, side] = seconds_of((ours, baseline)[side], calls, wait, clock)
        after()
    return measurement(name, seconds[1:], goal, units=calls * units)


def seconds_of(
    call: Call, calls: int = 1, wait: Call = nothing, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Returns the seconds of some calls; kernels are waited for before and after them."""
    wait()
    started = clock()
    for _ in range(calls):
        call()
    wait()
    return clock() - started


def measurement(name: str, seconds: np.ndarray, goal: Goal, *, units: int = 1) -> Measurement:
    """Returns the medians of times of ours and of the baseline, (turns, 2), each of so many units."""
    ours, baseline = seconds.T / units
    ratios = baseline / ours if goal.at_least and not goal.absolute else ours / baseline
    times = {"ours_s": float(np.median(ours)), "baseline_s": float(np.median(baseline))}
    return Measurement(name=name, **times, ratio=float(np.median(ratios)), goal=goal)


def require_same_physics(gap: float, limit: float = 1e-5) -> None:
    """Raises a :class:`SimulatorError` if the joints of two sides ended further apart than so many rad."""
    if not gap <= limit:  # NaN is not <=
        raise SimulatorError(f"The joints ended {gap:.2g} apart: this is not the same physics.")


def cuda_wait(device: str) -> Call:
    """Returns what waits for the kernels of a Torch device; on a CPU it does nothing."""
    if not device.startswith("cuda"):
        return nothing
    import torch

    return partial(torch.cuda.synchronize, device)


type Parts = Mapping[str, Callable[[], Measurement]]
"""What is measured, by the names that ``parts=[...]`` takes; each is called once."""


def part[F: Callable[..., Measurement]](name: str, *args: Any, **options: Any) -> Callable[[F], F]:
    """Makes a method of a :class:`Program` one of its parts; for several parts it is repeated.

    Args:
        name: Of the part.
        *args: What the method gets.
        **options: What it gets by name.
    """

    def mark(method: F) -> F:
        method.__dict__["parts"] = {name: (args, options)} | method.__dict__.get("parts", {})
        return method

    return mark


def part_each[F: Callable[..., Measurement]](*names: str) -> Callable[[F], F]:
    """Makes a method a part of each name, which it gets; see :func:`part`."""

    def mark(method: F) -> F:
        for name in reversed(names):
            method = part(name, name)(method)
        return method

    return mark


@dataclass(frozen=True, kw_only=True, slots=True)
class Program:
    """Keys of every speed program.

    Attributes:
        parts: What is measured, as in parts=[a,b]; all parts by default.
        out: JSON file for the measurements, rewritten after each; none by default.
    """

    one_core: ClassVar[bool] = False
    """Whether it runs on one core."""
    environment: ClassVar[Mapping[str, str]] = {}
    """Environment variables that it sets where they are not set already."""

    parts: tuple[str, ...] = ()
    out: Path | None = None

    def __post_init__(self) -> None:
        numbers = [item for item in fields(self) if type(item.default) in (int, float)]
        sizes = {item.name for item in numbers if item.metadata}  # 0 of them is what suits the device
        check_ranges(self, from_0=sizes, above_0={item.name for item in numbers} - sizes)

    def sized(self) -> Self:
        """Returns what measures: this, or for a device a copy with its sizes."""
        return self

    def prepare(self) -> None:
        """Called before anything is measured."""

    def compare(self, name: str, ours: Call, baseline: Call, goal: Goal = NO_GOAL, **how: Any) -> Measurement:
        """Returns :func:`compare`, with the turns and the device of the program where ``how`` has none."""
        own = {key: getattr(self, key) for key in ("turns", "device") if hasattr(self, key)}
        return compare(name, ours, baseline, goal, **(own | how))

    def measurements(self) -> Parts:
        """Returns all that can be measured, in the order of the class."""
        sized = self.sized()
        sized.prepare()
        methods = [method for method in vars(type(self)).values() if hasattr(method, "parts")]
        return {
            name: partial(method, sized, *args, **options)
            for method in methods
            for name, (args, options) in method.parts.items()
        }


@dataclass(frozen=True, kw_only=True, slots=True)
class DeviceProgram(Program):
    """Keys of a speed program for a GPU; on a CPU small sizes show that it works.

    Attributes:
        device: ``auto``, ``cpu``, ``cuda``, ``cuda:1``. A size that is 0 becomes what suits the device.
    """

    device: str = "auto"

    @property
    def on_gpu(self) -> bool:
        """Whether the device is a GPU; on a CPU goals do not apply."""
        return self.device != "cpu"

    @override
    def sized(self) -> Self:
        from roboverse_learn.training.device import resolve_device

        device = resolve_device(self.device)
        kind = device.partition(":")[0]
        sizes = {item.name: item.metadata[kind] for item in fields(self) if item.metadata}
        return replace(self, device=device, **{key: getattr(self, key) or sizes[key] for key in sizes})


def scaled(gpu: int, cpu: int) -> Any:
    """Returns the field of a size of a :class:`DeviceProgram`: 0, or what suits the device."""
    return field(default=0, metadata={"cuda": gpu, "cpu": cpu})


def program(name: str, kind: type[Program], words: Sequence[str] | None = None) -> int:
    """Runs ``roboverse speed <name>``: reads its keys, measures its parts, prints one table.

    Args:
        name: Of the program.
        kind: The program, whose fields are its keys.
        words: Its keys, as in ``parts=[a]``; those of this process by default.

    Returns:
        1 if a goal is missed, a part failed or nothing was measured; 2 for wrong keys; else 0. A part whose
        optional package is absent is reported as not measured.
    """

    def run(chosen: Program) -> int:
        for key, value in chosen.environment.items():
            os.environ.setdefault(key, value)
        if chosen.one_core:
            use_one_core()
        available = chosen.measurements()
        for part in chosen.parts:
            if part not in available:
                raise unknown_name(f"part of speed {name}", part, available)
        rows, failed = list[Row](), False
        for part in chosen.parts or available:
            try:
                rows.append(available[part]())
            except RoboVerseError as error:
                rows.append((part, str(error)))
                failed |= not isinstance(error, MissingExtraError)
            sys.stderr.write(f"{'  '.join(_cells(rows[-1]))}\n")  # now: the rest may take minutes
            if chosen.out is not None:
                chosen.out.parent.mkdir(parents=True, exist_ok=True)
                write_json(chosen.out, {"program": name, "rows": [_record(row) for row in rows]})
        sys.stdout.write(table(rows))
        results = [row.result for row in rows if isinstance(row, Measurement)]
        return int(failed or "missed" in results or not results)

    return run_program(f"roboverse speed {name}", kind, run, words)


type Row = Measurement | tuple[str, str]
"""A measurement, or the name of a part that was not measured and the reason."""


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
    units = ((1.0, "s"), (1e3, "ms"), (1e6, "µs"))
    scale, unit = next((item for item in units if seconds * item[0] >= 1.0), units[-1])
    return f"{seconds * scale:.3g} {unit}" if seconds * scale < 1000 else f"{seconds * scale:.0f} {unit}"


def _record(row: Row) -> dict[str, Any]:
    if isinstance(row, tuple):
        return {"name": row[0], "not_measured": row[1]}
    return asdict(row) | {"result": row.result}

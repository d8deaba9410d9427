"""Results of a suite: which result each of its tasks has, and the mean over them.

A suite's file, ``results/suites/<suite>/<policy>/<run>.json``, names the results of its tasks. Its numbers
follow from those results alone, and are computed again from them wherever they are shown.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from benchmark.protocol import Cell, Protocol
from benchmark.records import CellSummary, Result
from benchmark.statistics import mean_of_rates, out_to_spread
from benchmark.unregistered import check_registered
from envs.core.atomic import write_file
from envs.core.errors import ResultError, RoboVerseError, UnregisteredError

FOLDER = "suites"
"""Folder below the results."""

SCHEMA_VERSION = 1

_AGAIN = "Run the evaluation again, which takes over what is finished, or remove the file."


@dataclass(frozen=True, kw_only=True, slots=True)
class SuiteResult:
    """An evaluation of every task of a suite.

    Attributes:
        suite: Registered name of the suite.
        run: Name of the evaluation, unique for a suite and policy.
        policy: Policy.
        created: When it was made, ISO 8601 in UTC.
        protocol: What each task was evaluated on.
        named_protocol: Name of another benchmark's protocol, or empty.
        tasks: All tasks, in the suite's order.
        results: Task to the path of its result, below the folder of results.
        failed: Task to the reason why it has none.
    """

    suite: str
    run: str
    policy: str
    created: str
    protocol: Protocol
    named_protocol: str = ""
    tasks: tuple[str, ...]
    results: Mapping[str, str]
    failed: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, slots=True)
class SuiteCell:
    """One cell over all tasks of a suite that have a result.

    Attributes:
        cell: The cell.
        tasks: Number of tasks.
        episodes: Episodes of all tasks.
        successes: How many succeeded.
        success_rate: Mean of the tasks' success rates.
        ci_low: Lower end of the 95 % interval over tasks and episodes; see :func:`mean_over_tasks`.
        ci_high: Upper end.
    """

    cell: Cell
    tasks: int
    episodes: int
    successes: int
    success_rate: float
    ci_low: float
    ci_high: float

    def to_json(self) -> dict[str, Any]:
        """Returns plain JSON values."""
        values = {name: getattr(self, name) for name in self.__slots__ if name != "cell"}
        return self.cell.to_json() | values


def mean_over_tasks(rates: Sequence[tuple[float, float, float]]) -> tuple[float, float, float]:
    """Returns the mean success rate over tasks, every task weighing the same, and its 95 % interval.

    The interval has both sources of variation: which episodes a task has, and which tasks the suite has.
    Each end is whichever is further out of two: that of the mean of these very tasks
    (:func:`~benchmark.statistics.mean_of_rates`, which does not call 20 of 20 certain), and that of Student's
    t over the tasks' rates (:func:`~benchmark.statistics.mean_of_few`).

    Args:
        rates: Success rate of every task with both ends of its own interval.

    Returns:
        Mean, lower end, upper end.

    Raises:
        ValueError: There are no tasks.
    """
    mean, low, high = mean_of_rates(rates)
    return mean, *out_to_spread(low, high, [rate for rate, _, _ in rates])


def summarize_suite(results: Mapping[str, Result]) -> tuple[SuiteCell, ...]:
    """Returns the summary of every cell that all of the results have, in their order.

    Args:
        results: Task to its result.
    """
    if not results:
        return ()
    by_cell: dict[Cell, list[CellSummary]] = {}
    for result in results.values():
        for summary in result.cells():
            by_cell.setdefault(summary.cell, []).append(summary)
    return tuple(_summary(cell, of) for cell, of in by_cell.items() if len(of) == len(results))


def _summary(cell: Cell, of_tasks: Sequence[CellSummary]) -> SuiteCell:
    mean, low, high = mean_over_tasks([(each.success_rate, each.ci_low, each.ci_high) for each in of_tasks])
    return SuiteCell(
        cell=cell,
        tasks=len(of_tasks),
        episodes=sum(each.episodes for each in of_tasks),
        successes=sum(each.successes for each in of_tasks),
        success_rate=mean,
        ci_low=low,
        ci_high=high,
    )


def suite_path(results_dir: Path, suite: SuiteResult) -> Path:
    """Returns where the file of a suite belongs."""
    return results_dir / FOLDER / suite.suite / suite.policy / f"{suite.run}.json"


def write_suite(results_dir: Path, suite: SuiteResult, results: Mapping[str, Result]) -> Path:
    """Writes the file of a suite, atomically; returns its path.

    Args:
        results_dir: Folder of results.
        suite: What was evaluated.
        results: Task to its result, for the summary.

    Raises:
        WriteError: It cannot be written.
    """
    values = {item.name: getattr(suite, item.name) for item in fields(SuiteResult)}
    values |= {"protocol": suite.protocol.to_json(), "tasks": list(suite.tasks)}
    values |= {"results": dict(suite.results), "failed": dict(suite.failed)}
    document = {"schema_version": SCHEMA_VERSION, **values}
    document["cells"] = [cell.to_json() for cell in summarize_suite(results)]
    path = suite_path(results_dir, suite)
    write_file(path, (json.dumps(document, indent=1, allow_nan=False) + "\n").encode())
    return path


def read_suite(path: Path) -> SuiteResult:
    """Reads the file of a suite.

    Raises:
        ResultError: It is no such file, or not whole.
        UnregisteredError: It is of a channel or level that is not registered here.
    """
    try:
        document = json.loads(path.read_bytes())
        if document["schema_version"] != SCHEMA_VERSION:
            raise ValueError(f"it has schema version {document['schema_version']!r}")
        values = {item.name: document[item.name] for item in fields(SuiteResult)}
        check_registered(path, document)
        protocol = Protocol.from_json(values["protocol"])
        suite = SuiteResult(**values | {"protocol": protocol, "tasks": tuple(values["tasks"])})
        unknown = {*suite.results, *suite.failed} - {*suite.tasks}
        if unknown:
            raise ValueError(f"'{min(unknown)}' is none of its tasks")
    except OSError as error:
        raise ResultError(f"Could not read '{path}': {error.strerror or error}.") from error
    except UnregisteredError:
        raise
    except KeyError as error:
        raise ResultError(f"'{path}' is no result of a suite: it has no {error}. {_AGAIN}") from error
    except (ValueError, TypeError, RoboVerseError) as error:
        raise ResultError(f"'{path}' is no result of a suite: {error}. {_AGAIN}") from error
    return suite

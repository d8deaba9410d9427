"""Commands over a suite: one task after the other; one that cannot run is named, and the others go on."""

import contextlib
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from envs.core.errors import ConfigError, RoboVerseError, WriteError
from envs.core.json_values import to_json_values
from envs.tasks.suites import suite_tasks
from roboverse_learn.commands.checkpoint_names import checkpoint_name
from roboverse_learn.commands.outcomes import Evaluation
from roboverse_learn.commands.tested_checkpoint import (
    TestedCheckpoint,
    checkpoints_to_test,
    protocol_of,
)
from roboverse_learn.config.schema import CollectConfig, EvaluateConfig
from roboverse_learn.config.serialize import from_values, to_values

if TYPE_CHECKING:
    from benchmark.suites import SuiteCell
    from roboverse_learn.data.collection.collect import CollectionSummary

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, slots=True)
class SuiteCollection:
    """Demonstrations of every task of a suite.

    Attributes:
        suite: The suite.
        collected: Task to what was collected.
        failed: Task to the reason why it has none.
    """

    suite: str
    collected: "Mapping[str, CollectionSummary]"
    failed: Mapping[str, str]


@dataclass(frozen=True, kw_only=True, slots=True)
class SuiteEvaluation:
    """Evaluation of every task of a suite.

    Attributes:
        suite: The suite.
        path: File of the suite's result.
        evaluations: Task to its evaluation.
        cells: Means over the tasks.
        failed: Task to the reason why it has no result.
    """

    suite: str
    path: Path
    evaluations: Mapping[str, Evaluation]
    cells: "tuple[SuiteCell, ...]"
    failed: Mapping[str, str]


def collect_suite(
    config: CollectConfig, collect_dataset: "Callable[[CollectConfig], CollectionSummary]"
) -> SuiteCollection:
    """Completes a dataset for each task of a suite.

    Args:
        config: The configuration with the suite.
        collect_dataset: Completes the dataset of one task's configuration.

    Raises:
        ConfigError: No task could be collected.
    """
    from roboverse_learn.commands.tasks_at_once import collect_in_parallel

    values = to_values(config) | {"suite": ""}

    def of_task(task: str) -> CollectConfig:
        return from_values("collect", values | {"task": task})

    def collect(task: str) -> "CollectionSummary":
        return collect_dataset(of_task(task))

    if config.tasks_at_once > 1:
        collect_in_parallel(list(_found(of_task, suite_tasks(config.suite)).values()))
    collected, failed = _each_task(config.suite, collect)
    return SuiteCollection(suite=config.suite, collected=collected, failed=failed)


def evaluate_suite(
    config: EvaluateConfig, evaluate_checkpoint: Callable[[TestedCheckpoint], Evaluation]
) -> SuiteEvaluation:
    """Evaluates a checkpoint or a baseline in every task of a suite, and writes the suite's result.

    What was evaluated before is not run again.

    Args:
        config: The configuration with the suite.
        evaluate_checkpoint: Evaluates it in one task and writes its result.

    Raises:
        ConfigError: No task could be evaluated.
    """
    from benchmark import provenance
    from benchmark.suites import SuiteResult, summarize_suite, write_suite
    from roboverse_learn.commands.tasks_at_once import evaluate_in_parallel

    results_dir = Path(config.results_dir)

    def tested(task: str) -> TestedCheckpoint:
        values = to_values(config) | {"suite": "", "task": task}  # its options are checked by the task
        (one,) = checkpoints_to_test(from_values("evaluate", values))
        return one

    def evaluate(task: str) -> Evaluation:
        return evaluate_checkpoint(tested(task))

    if config.tasks_at_once > 1:
        evaluate_in_parallel(config, list(_found(tested, suite_tasks(config.suite))))
    evaluations, failed = _each_task(config.suite, evaluate)
    results = {task: each.result for task, each in evaluations.items()}
    paths = {task: each.path for task, each in evaluations.items() if each.path is not None}
    suite = SuiteResult(
        suite=config.suite,
        run=_run_name(config),
        policy=next(iter(results.values())).policy,
        created=provenance.now(),
        protocol=protocol_of(config.evaluate),
        named_protocol=config.protocol,
        tasks=suite_tasks(config.suite),
        results={task: path.relative_to(results_dir).as_posix() for task, path in paths.items()},
        failed=failed,
    )
    path = write_suite(results_dir, suite, results)
    return SuiteEvaluation(
        suite=config.suite,
        path=path,
        evaluations=evaluations,
        cells=summarize_suite(results),
        failed=failed,
    )


def _found[T](find: Callable[[str], T], tasks: Sequence[str]) -> dict[str, T]:
    """Returns what is found for each task; why another one has nothing is said later."""
    found = {}
    for task in tasks:
        with contextlib.suppress(RoboVerseError):
            found[task] = find(task)
    return found


def _each_task[T](suite: str, do: Callable[[str], T]) -> tuple[dict[str, T], dict[str, str]]:
    """Does something for every task of a suite; returns what came of it, and why some tasks failed.

    Raises:
        WriteError: Nothing can be written, whatever the task.
        ConfigError: All tasks failed.
    """
    tasks = suite_tasks(suite)
    done: dict[str, T] = {}
    failed: dict[str, str] = {}
    for number, task in enumerate(tasks, start=1):
        log.info("Task %d of %d: %s", number, len(tasks), task)
        try:
            done[task] = do(task)
        except WriteError:
            raise
        except RoboVerseError as error:
            failed[task] = str(error)
            log.warning("%s is left out: %s", task, brief_reasons(failed)[task])
    if not done:
        reasons = [why for task, why in brief_reasons(failed).items() if why == failed[task]]
        others = len(reasons) - 1
        more = f" (and {others} other reason{'s' * (others > 1)})" if others else ""
        raise ConfigError(f"No task of the suite '{suite}' could run: {reasons[0]}{more}")
    return done, failed


def brief_reasons(failed: Mapping[str, str]) -> dict[str, str]:
    """Returns why tasks failed, where a reason that is another task's, too, is not said a second time."""
    brief, first_of = {}, {}
    for task, why in failed.items():
        first = first_of.setdefault(why.replace(task, ""), task)
        brief[task] = why if task == first else f"the same as for {first}"
    return brief


def _run_name(config: EvaluateConfig) -> str:
    """Returns the name of a suite's evaluation: the run or baseline, and a hash of what is evaluated."""
    from envs.core.fingerprint import digest, file_hash
    from policies.checkpoint import weights_path
    from roboverse_learn.commands.foreign_checkpoint import open_checkpoint
    from roboverse_learn.commands.run_folder import step_of

    decides: dict[str, Any] = {
        "protocol": protocol_of(config.evaluate).to_json(),
        "env": to_json_values(config.env),
    }
    decides |= {"materials": config.evaluate.materials, "named": config.protocol}
    if config.rename_map:
        decides["rename_map"] = dict(config.rename_map)
    base = config.policy_name
    if not base:
        checkpoint = open_checkpoint(config.checkpoint)
        base = checkpoint_name(config.checkpoint, checkpoint)
        decides |= {"weights": file_hash(weights_path(checkpoint)), "step": step_of(checkpoint)}
    return f"{base}-{digest(decides)}"

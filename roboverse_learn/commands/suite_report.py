"""What a command over a suite prints: a line for each task, the mean, and what was left out and why."""

from collections.abc import Mapping
from pathlib import Path

from rich.console import Group
from rich.table import Table

from roboverse_learn.commands.report import (
    board_paths,
    in_scene,
    listed_paths,
    pages_to_open,
    rate_text,
    unbroken,
    wording_table,
)
from roboverse_learn.commands.suite import SuiteCollection, SuiteEvaluation, brief_reasons


class SuiteReport(Group):
    """A printable report.

    Attributes:
        ok: Whether no task was left out; else the command's exit code is 1.
    """

    ok: bool = True


def suite_collection_report(suite: SuiteCollection) -> SuiteReport:
    """Demonstrations of each task, and their folders."""
    table = Table(title=f"{suite.suite}: demonstrations", title_justify="left")
    for title in ("task", "demonstrations", "frames", "expert or source succeeds"):
        table.add_column(title, overflow="fold")
    for task, each in suite.collected.items():
        share = f"{100 * each.success_rate:.0f} %"
        table.add_row(task, str(each.num_episodes), f"{each.num_frames:,}", share)
    folders = {task: each.root for task, each in suite.collected.items()}
    return _with_failures(suite.failed, table, listed_paths(folders))


def suite_evaluation_report(suite: SuiteEvaluation, board: Mapping[str, Path]) -> SuiteReport:
    """Success of each task on every cell, their mean, what held-out wordings cost, and where results are."""
    first = next(iter(suite.evaluations.values())).result
    cells = [each.cell for each in suite.cells]
    episodes = first.protocol.episodes
    title = f"{in_scene(suite.suite, first.env)}, {first.policy}: success in {episodes} episodes of each task"
    table = Table(title=title, title_justify="left")
    table.add_column("task", overflow="fold")
    for cell in cells:
        table.add_column(str(cell), justify="right")
    for task, each in suite.evaluations.items():
        by_cell = {summary.cell: summary for summary in each.result.cells()}
        table.add_row(task, *(rate_text(by_cell[cell]) for cell in cells))
    table.add_section()
    table.add_row(f"mean of {len(suite.evaluations)} tasks", *(rate_text(each) for each in suite.cells))
    worded = wording_table([*suite.evaluations.values()])
    tables = [table] if worded is None else [table, worded]
    written = {"suite": suite.path} | board_paths(board)
    return _with_failures(suite.failed, *tables, listed_paths(written), listed_paths(pages_to_open(board)))


def _with_failures(failed: Mapping[str, str], *parts: Table | Group) -> SuiteReport:
    reasons = brief_reasons(failed)
    lines = [f"Left out {len(failed)}:", *(f"  {task}: {why}" for task, why in reasons.items())]
    report = SuiteReport(*parts, *([unbroken("\n".join(lines))] if failed else []))
    report.ok = not failed
    return report

"""The table of instruction tests: whether a policy reads, beside how well it does."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from benchmark.instruction_scores import instruction_scores, wording_gaps
from benchmark.leaderboard.rows import Entry, policy_label, training_length
from benchmark.protocol import HELD_OUT, INSTRUCTION_TESTS, NOT_ASKED
from benchmark.records import Result

_SPLIT = "test"


def without_instruction_tests(result: Result) -> Result:
    """Returns a result without its instruction tests: what the other tables rank, whoever ran them too."""
    if not result.protocol.instructions:
        return result
    records = tuple(record for record in result.records if record.instruction_test is None)
    return replace(result, protocol=replace(result.protocol, instructions=()), records=records)


def instructions_table(results: Sequence[Entry]) -> list[dict[str, Any]]:
    """Returns a row for each run with instruction tests on the test split, ordered by task and policy.

    A row has the run, ``right``, the success rate with the task's own words, ``scores`` by test and
    ``gaps`` by kind of held-out wording, where known ones were tested, too; see
    :class:`~benchmark.instruction_scores.InstructionScore` and
    :class:`~benchmark.instruction_scores.WordingGap`.
    """
    rows = [_row(path, result) for path, result in results if result.protocol.instructions]
    return sorted(
        (row for row in rows if row["scores"]),
        key=lambda row: (row["task"], row["policy"], row["label"], row["seed"], row["path"]),
    )


def instructions_view(table: Sequence[Mapping[str, Any]], latest: str | None) -> dict[str, Any]:
    """Returns the view of the page: one table for other words, one for what was not asked."""
    tested = {test for row in table for test in row["scores"]}
    groups = {
        "reworded": [test for test in INSTRUCTION_TESTS if test not in NOT_ASKED],
        "not_asked": NOT_ASKED,
    }
    tables = {}
    for name, tests in groups.items():
        columns = [test for test in tests if test in tested]
        rows = [row for row in table if any(test in row["scores"] for test in columns)]
        gaps = [kind for kind in HELD_OUT if kind in columns and any(kind in row["gaps"] for row in rows)]
        tables[name] = {"columns": columns, "gaps": gaps, "rows": rows}
    return {"tables": tables, "tasks": [], "latest": latest}


def _row(path: str, result: Result) -> dict[str, Any]:
    scores = [score for score in instruction_scores(result.records) if score.split == _SPLIT]
    gaps = {gap.wording: gap.to_json() for gap in wording_gaps(result.records) if gap.split == _SPLIT}
    return {
        "path": path,
        "run": result.run,
        "task": result.env.task,
        "policy": result.policy,
        "label": policy_label(result),
        "recipe": result.recipe or None,
        "train_level": result.train_level,
        "train_only": result.train_only,
        "demonstrations": result.demonstrations,
        **training_length(result),
        "seed": result.seed,
        "simulator": result.env.simulator,
        "renderer": result.env.renderer,
        "episodes": scores[0].episodes if scores else 0,
        "right": scores[0].right_rate if scores else None,
        "scores": {score.instruction_test: score.to_json() for score in scores},
        "gaps": gaps,
    }

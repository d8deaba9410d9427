"""Records in a results file: the episodes of a cell side by side, each of their fields a list.

A line for every episode would repeat its keys, its cell and its words: about three times as many bytes.
"""

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from benchmark.records import EpisodeRecord
from envs.core.errors import ResultError

_COLUMNS = ("episode", "initial_state_hash", "success", "length", "episode_return", "wall_time_s")
_INSTRUCTION_COLUMNS = ("instruction", "switched_at", "switched_to")
"""Columns that are there only where the records have such values."""

_WORDED = ("instruction", "switched_to")
"""Columns of instructions, each the index of a wording."""


def to_columns(records: Sequence[EpisodeRecord]) -> tuple[list[dict[str, Any]], list[str]]:
    """Returns the records of each cell as lists, in order, and the wordings that these name by index."""
    wordings: dict[str, int] = {}
    cells = []
    for (cell, given), group in groupby(records, lambda record: (record.cell, _given(record))):
        entry, of_cell = cell.to_json(), list(group)
        for name in (*_COLUMNS, *given):
            values = [getattr(record, name) for record in of_cell]
            if name in _WORDED:
                values = [wordings.setdefault(words, len(wordings)) for words in values]
            entry[name] = values
        cells.append(entry)
    return cells, list(wordings)


def to_rows(cells: Sequence[Mapping[str, Any]], wordings: Sequence[str]) -> list[dict[str, Any]]:
    """Returns one dictionary for each record of :func:`to_columns`.

    Raises:
        ResultError: The lists of a cell differ in length, or one names a wording that is not there.
    """
    rows: list[dict[str, Any]] = []
    for index, cell in enumerate(cells):
        columns = {name: values for name, values in cell.items() if isinstance(values, list)}
        shared = {name: value for name, value in cell.items() if name not in columns}
        lengths = sorted({len(values) for values in columns.values()})
        if len(lengths) != 1:
            raise ResultError(f"the lists of records/{index} have {' and '.join(map(str, lengths))} values.")
        for name in _WORDED:
            if name in columns:
                columns[name] = [_wording(wordings, number, index) for number in columns[name]]
        rows += [
            shared | dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)
        ]
    return rows


def _given(record: EpisodeRecord) -> tuple[str, ...]:
    """Returns the columns of instructions that a record has values for."""
    return tuple(name for name in _INSTRUCTION_COLUMNS if getattr(record, name) is not None)


def _wording(wordings: Sequence[str], number: int, index: int) -> str:
    if number >= len(wordings):
        raise ResultError(f"records/{index} names wording {number}, and the file has {len(wordings)}.")
    return wordings[int(number)]  # a schema takes 0.0 for an integer

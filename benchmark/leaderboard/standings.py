"""What each entry reached in one section, by the two protocols of the benchmark.

**A**, generalization: trained at level 0, tested at every level. **B**, as the paper's table: trained at the
level that is tested. They ask different questions, and no number of one is ranked with one of the other.
"""

from collections.abc import Mapping
from typing import Any

from benchmark.leaderboard.entries import BASELINE, ENTRY

PROTOCOLS = ("A", "B")

type Series = dict[str, Any]


def standings(section: Mapping[str, Any]) -> dict[str, list[Series]]:
    """Returns the series of each protocol.

    Args:
        section: One of :func:`benchmark.leaderboard.build.build`.

    Returns:
        Of ``"A"`` and ``"B"``, one series per entry and place of its training: ``entry``,
        ``transferred_from``, ``rows`` (indices of its rows in the section) and ``cells``, of tested level
        (as text) to ``test`` and ``train``, the cells of the row that the protocol asks for; of A also
        ``alone``, the same by the channel that varied alone. Baselines, which learned nothing, are in both.
        Series are in the order of the section's rows.
    """
    found: dict[str, dict[tuple[Any, ...], Series]] = {name: {} for name in PROTOCOLS}
    for index, row in enumerate(section["rows"]):
        if row["kind"] not in (ENTRY, BASELINE):
            continue
        for protocol, series in found.items():
            cells = _cells(row, protocol)
            alone = _alone(row) if protocol == "A" else {}
            if cells or alone:
                key = (row["entry"], row["transferred_from"]) if row["entry"] else (index,)
                own = series.setdefault(
                    key,
                    {
                        "entry": row["entry"],
                        "label": row["label"],
                        "policy": row["policy"],
                        "transferred_from": row["transferred_from"],
                        "rows": [],
                        "cells": {},
                        "alone": {},
                    },
                )
                own["rows"].append(index)
                own["cells"] |= cells
                own["alone"] |= alone
    return {
        name: [each | {"cells": dict(sorted(each["cells"].items()))} for each in series.values()]
        for name, series in found.items()
    }


def _alone(row: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Returns the cells of a row where one channel varied alone, if it belongs to protocol A."""
    cells: dict[str, dict[str, Any]] = {}
    for cell in row["cells"]:
        if cell["only"] is not None and row["train_level"] in (0, None):
            cells.setdefault(cell["only"], {})[cell["split"]] = cell
    return {only: of for only, of in cells.items() if "test" in of}


def _cells(row: Mapping[str, Any], protocol: str) -> dict[str, dict[str, Any]]:
    """Returns the cells of a row that belong to a protocol, by tested level and split."""
    cells: dict[str, dict[str, Any]] = {}
    for cell in row["cells"]:
        level = cell["level"]
        if level is None:
            continue
        trained_at = 0 if protocol == "A" else level
        if row["kind"] == BASELINE or row["train_level"] == trained_at:
            cells.setdefault(str(level), {})[cell["split"]] = cell
    return {level: of for level, of in cells.items() if "test" in of}

"""How often the expert of each task succeeds, as ``python -m envs.experts.survey`` last counted it.

The file is ``results/tasks.json`` of a checkout, and a copy of it in an installed package. Nothing heavy is
imported here, so that listings may read it.
"""

from pathlib import Path
from typing import Any

from envs.core.json_file import read_kept

CHECKOUT, PACKAGED = (
    Path(__file__).parents[2] / "results" / "tasks.json",
    Path(__file__).with_name("tasks.json"),
)


def counts_file() -> Path:
    """Returns the file of counts: that of the checkout, or that of the installed package."""
    return PACKAGED if PACKAGED.is_file() else CHECKOUT


def read_rows(path: Path) -> dict[str, dict[str, Any]]:
    """Returns the rows of a file of counts by task; none if there is no file.

    Raises:
        ConfigError: The file is damaged.
    """
    return read_kept(path, _checked, "has no rows of tasks", "Restore it, or remove it.") or {}


def _checked(rows: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    if not all(isinstance(row, dict) for row in rows.values()):
        raise ValueError("a row is no object")
    return rows


def read_counts() -> dict[str, tuple[float, int]]:
    """Returns the share of solved starts and their number, of each task that was counted.

    Raises:
        ConfigError: The file is damaged.
    """
    rows = read_rows(counts_file())
    return {name: (row["expert"], row["episodes"]) for name, row in rows.items() if row.get("episodes")}

"""How often the expert of each task succeeds, as ``python -m envs.experts.survey`` last counted it.

The file is ``results/tasks.json`` of a checkout, and a copy of it in an installed package. Nothing heavy is
imported here, so that listings may read it.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from envs.core.json_file import read_kept

CHECKOUT, PACKAGED = (
    Path(__file__).parents[2] / "results" / "tasks.json",
    Path(__file__).with_name("tasks.json"),
)


@dataclass(frozen=True, slots=True)
class ExpertCount:
    """How often an expert succeeded.

    Attributes:
        episodes: Starts of the test split.
        success_rate: Share of them that were solved, in [0, 1].
        mean_steps: Mean number of control steps.
    """

    episodes: int
    success_rate: float
    mean_steps: float

    def __str__(self) -> str:
        """Returns the success rate in percent and the number of starts: ``"99.6 % of 500"``."""
        return f"{100 * self.success_rate:.4g} % of {self.episodes}"


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


def read_counts() -> dict[str, ExpertCount]:
    """Returns the count of each task whose expert was counted.

    Raises:
        ConfigError: The file is damaged.
    """
    rows = read_rows(counts_file())
    return {
        name: ExpertCount(row["episodes"], row["expert"], row["mean_steps"])
        for name, row in rows.items()
        if row.get("episodes")
    }

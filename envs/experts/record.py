"""Success rates of the experts as last measured: a JSON file beside the tasks.

``python -m envs.experts.check task=PickCube record=true`` measures and writes one; listings and
pages read the file without importing anything heavy.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from envs.core.atomic import write_file
from envs.core.json_file import read_kept

RECORDS = Path(__file__).parents[1] / "tasks" / "experts.json"
"""The file, part of the package."""


@dataclass(frozen=True, slots=True)
class SplitRecord:
    """The measurement on one split.

    Attributes:
        num_episodes: Number of episodes.
        success_rate: Share of them that were solved, in [0, 1].
        mean_steps: Mean number of control steps.
    """

    num_episodes: int
    success_rate: float
    mean_steps: float


@dataclass(frozen=True, slots=True)
class ExpertRecord:
    """The measurement of one task's expert.

    Attributes:
        splits: Split to its measurement.
        command: The command that measured it.
        git_sha: Commit of the checkout, with ``+`` if files differed from it; None outside a checkout.
    """

    splits: Mapping[str, SplitRecord]
    command: str
    git_sha: str | None

    def __str__(self) -> str:
        """Returns the success rates of the splits in percent: ``"100.0 / 99.8 %"``."""
        return " / ".join(f"{100 * split.success_rate:.1f}" for split in self.splits.values()) + " %"


def read_records(path: Path = RECORDS) -> dict[str, ExpertRecord]:
    """Returns the record of each task; none if there is no file.

    Raises:
        ConfigError: The file is damaged.
    """
    remedy = "Restore it, or measure again: python -m envs.experts.check task=<task> record=true"
    return read_kept(path, _parsed, "does not say how often experts succeed", remedy) or {}


def _parsed(raw: dict[str, Any]) -> dict[str, ExpertRecord]:
    return {
        task: ExpertRecord(
            {split: SplitRecord(**values) for split, values in record["splits"].items()},
            record["command"],
            record["git_sha"],
        )
        for task, record in raw.items()
    }


def write_record(task: str, record: ExpertRecord, path: Path = RECORDS) -> None:
    """Writes one task's record into the file atomically; those of other tasks stay."""
    records = {**read_records(path), task: record}
    text = json.dumps({name: asdict(records[name]) for name in sorted(records)}, indent=1) + "\n"
    write_file(path, text.encode())

"""The runs as ``roboverse list runs`` shows them: from their JSON files, the newest first."""

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from envs.core.errors import ConfigError
from roboverse_learn.commands.columns import columns
from roboverse_learn.commands.run_folder import CONFIG_FILE, MANIFEST_FILE
from roboverse_learn.progress import clock
from roboverse_learn.training.metrics import read_metrics

HEADINGS = ("run", "state", "steps", "success", "last written")
_RIGHT = (2,)
"""Columns of numbers."""

_MOST_ERROR_CHARACTERS = 60


def runs_in_detail(runs_dir: Path) -> str:
    """Returns a table of the runs below a folder.

    Success is that of the test split, or of the only other one: a number for each level, the mean over the
    tasks of a run that learned several. A run that says that it runs may have been killed: only the time
    since it wrote last tells.

    Args:
        runs_dir: The folder of runs; a run lies at any depth of it.

    Raises:
        ConfigError: The folder does not exist.
    """
    if not runs_dir.is_dir():
        raise ConfigError(f"There is no folder '{runs_dir}'. Name that of the runs: runs_dir=<folder>.")
    found = [(_last_written(path.parent), path.parent) for path in runs_dir.rglob(MANIFEST_FILE)
             if (path.parent / CONFIG_FILE).is_file()]  # fmt: skip
    if not found:
        return f"  none in '{runs_dir}'"
    rows = [(str(folder.relative_to(runs_dir)), *_facts(folder), _ago(written))
            for written, folder in sorted(found, reverse=True)]  # fmt: skip
    return "\n".join(columns([HEADINGS, *rows], _RIGHT))


def _facts(folder: Path) -> tuple[str, str, str]:
    """Returns the state of a run, its steps and its success."""
    try:
        manifest = json.loads((folder / MANIFEST_FILE).read_text(encoding="utf-8"))
        stages, status = manifest["stages"], str(manifest["status"])
        wanted = manifest["config"]["train"]["steps"]
        done = stages.get("train", {}).get("steps") or _steps_so_far(folder)
        return _state(status, stages), f"{done:,} of {wanted:,}", _success(stages.get("evaluate", {}))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return "its manifest is damaged", "-", "-"


def _state(status: str, stages: Mapping[str, Any]) -> str:
    stage = list(stages)[-1] if stages else "start"
    if status == "done":
        return "done"
    if error := str(stages.get(stage, {}).get("error", "")):
        kind, _, said = error.partition(": ")
        said = said or kind
        short = said if len(said) <= _MOST_ERROR_CHARACTERS else said[: _MOST_ERROR_CHARACTERS - 1] + "…"
        return f"stopped in {stage}: {short}"
    return f"{status} in {stage}"


def _steps_so_far(folder: Path) -> int:
    rows = read_metrics(folder)
    return int(rows[-1]["step"]) if rows else 0


def _success(evaluated: Mapping[str, Any]) -> str:
    """Returns ``89, 2, 2, 2 %`` of levels 0 to 3; a dash where no results file is at hand."""
    by_cell: dict[tuple[str, int], list[float]] = {}
    for path in evaluated.get("results", ()):
        try:
            cells = json.loads(Path(path).read_text(encoding="utf-8"))["cells"]
        except (OSError, ValueError, KeyError, TypeError):
            continue  # moved, or damaged, which the commands that read it report
        for cell in cells:
            if cell.get("only") is None:
                by_cell.setdefault((cell["split"], cell["level"]), []).append(cell["success_rate"])
    splits = {split for split, _ in by_cell}
    split = "test" if "test" in splits else min(splits, default="")
    means = [100 * sum(rates) / len(rates) for key, rates in sorted(by_cell.items()) if key[0] == split]
    levels = [str(level) for each, level in sorted(by_cell) if each == split]
    return f"{', '.join(f'{mean:.0f}' for mean in means)} % at {'level' if len(levels) == 1 else 'levels'} " \
           f"{', '.join(levels)}" if means else "-"  # fmt: skip


def _last_written(folder: Path) -> float:
    """Returns when a run last wrote one of the files that grow, seconds since the epoch."""
    return max(path.stat().st_mtime for path in folder.iterdir() if path.is_file())


def _ago(written: float) -> str:
    return f"{clock(max(0.0, time.time() - written))} ago"

"""The runs as ``roboverse list runs`` shows them: from their JSON files, the newest first."""

import contextlib
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

_SPLITS = ("test", "validation", "train")
"""Splits, that of the headline first."""


def runs_in_detail(runs_dir: Path) -> str:
    """Returns a table of the runs below a folder.

    Success is that of the test split, else of validation or of train, which is then named: a number for
    each level, the mean over the tasks of a run that learned several. ``running`` is what a run wrote last:
    one that was killed says so, too.

    Args:
        runs_dir: The folder of runs; a run lies at any depth of it.

    Raises:
        ConfigError: The folder does not exist.
    """
    if not runs_dir.is_dir():
        raise ConfigError(f"There is no folder '{runs_dir}'. Name that of the runs: runs_dir=<folder>.")
    folders = [path.parent for path in runs_dir.rglob(MANIFEST_FILE) if (path.parent / CONFIG_FILE).is_file()]
    if not folders:
        return f"  none in '{runs_dir}'"
    newest_first = sorted(((_last_written(folder), folder) for folder in folders), reverse=True)
    rows = [(str(folder.relative_to(runs_dir)), *run_facts(folder), _ago(written))
            for written, folder in newest_first]  # fmt: skip
    return "\n".join(columns([HEADINGS, *rows], _RIGHT))


def run_facts(folder: Path) -> tuple[str, str, str]:
    """Returns the state of a run, its steps and its success, as words."""
    try:
        manifest = json.loads((folder / MANIFEST_FILE).read_text(encoding="utf-8"))
        stages, state = manifest["stages"], _state(str(manifest["status"]), manifest["stages"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return "its manifest is damaged", "-", "-"
    facts = []
    for read in (lambda: _steps(folder, manifest), lambda: _success(stages.get("evaluate", {}))):
        try:
            facts.append(read())
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            facts.append("-")
    return state, facts[0], facts[1]


def _state(status: str, stages: Mapping[str, Any]) -> str:
    """Returns what a run does, or where it stopped; stages of an earlier start keep their place."""
    if status == "done":
        return status
    open_ones = [name for name, facts in stages.items() if facts.get("status") != "done"]
    stage = (open_ones or list(stages) or ["start"])[-1]
    error = " ".join(str(stages.get(stage, {}).get("error", "")).split())
    if not error:
        return f"{status} in {stage}"
    said = error.partition(": ")[2] or error
    short = said if len(said) <= _MOST_ERROR_CHARACTERS else said[: _MOST_ERROR_CHARACTERS - 1] + "…"
    return f"stopped in {stage}: {short}"


def _steps(folder: Path, manifest: Mapping[str, Any]) -> str:
    trained, wanted = manifest["stages"].get("train", {}), manifest["config"]["train"]["steps"]
    rows = read_metrics(folder)
    so_far = int(rows[-1]["step"]) if rows else 0
    done = int(trained["steps"]) if trained.get("status") == "done" else so_far
    return f"{done:,} of {wanted:,}"


def _success(evaluated: Mapping[str, Any]) -> str:
    """Returns ``89, 2, 2, 2 % at levels 0, 1, 2, 3``; a dash where no results file is at hand."""
    by_cell: dict[tuple[str, int], list[float]] = {}
    for path in evaluated.get("results", ()):
        try:
            cells = json.loads(Path(path).read_text(encoding="utf-8"))["cells"]
        except (OSError, ValueError, KeyError, TypeError):
            continue  # moved, or damaged, which the commands that read it report
        for cell in cells:
            if cell.get("only") is None and cell.get("instruction_test") is None:
                by_cell.setdefault((cell["split"], cell["level"]), []).append(cell["success_rate"])
    split = next((each for each in _SPLITS if any(each == found for found, _ in by_cell)), "")
    means = {level: 100 * sum(rates) / len(rates)
             for (found, level), rates in sorted(by_cell.items()) if found == split}  # fmt: skip
    if not means:
        return "-"
    levels = f"level{'s' if len(means) > 1 else ''} {', '.join(map(str, means))}"
    named = "" if split == _SPLITS[0] else f", {split} split"
    return f"{', '.join(f'{mean:.0f}' for mean in means.values())} % at {levels}{named}"


def _last_written(folder: Path) -> float:
    """Returns when a run last wrote a file of its folder, its log among them, seconds since the epoch."""
    times = [0.0]
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # one that was written beside its place, and moved since
            times.append(path.stat().st_mtime if path.is_file() else 0.0)
    return max(times)


def _ago(written: float) -> str:
    return f"{clock(max(0.0, time.time() - written))} ago"

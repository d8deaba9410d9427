"""Results of CALVIN's chains in a file: which run solved how much of which chain.

The file has a list of runs for each policy; a run has its command, commit and seed, and ``solved``, which has
the number of tasks that were solved in a row by the index of the chain.
"""

import json
from pathlib import Path
from typing import Any

from envs.core.atomic import write_file
from envs.core.json_file import read_kept


class ChainResults:
    """The results of one policy, kept chain by chain beside those of others.

    Args:
        path: The file.
        label: The policy.
        run: Facts of the present run: ``command``, ``git_sha`` and ``seed``.

    Raises:
        ConfigError: The file is damaged.
    """

    def __init__(self, path: Path, label: str, run: dict[str, Any]) -> None:
        self._path, self._runs = path, read_runs(path)
        own = self._runs.setdefault(label, [])
        self.done = _solved(own)
        self._run = next((item for item in own if item == {**run, "solved": item["solved"]}), None)
        if self._run is None:
            self._run = {**run, "solved": {}}
            own.append(self._run)

    def add(self, index: int, count: int) -> None:
        """Keeps how many tasks of a chain were solved in a row."""
        self.done[index] = count
        assert self._run is not None
        solved = self._run["solved"] | {str(index): count}
        self._run["solved"] = {key: solved[key] for key in sorted(solved, key=int)}
        lines = [
            f" {json.dumps(label)}: [\n  " + ",\n  ".join(json.dumps(run) for run in runs) + "\n ]"
            for label, runs in sorted(self._runs.items())
            if runs
        ]
        write_file(self._path, ("{\n" + ",\n".join(lines) + "\n}\n").encode())


def read_runs(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Returns the runs of each policy; none if there is no file.

    Raises:
        ConfigError: The file is damaged.
    """
    return read_kept(path, _checked, "has no results of chains", "Restore it, or remove it.") or {}


def read_results(path: Path) -> dict[str, dict[int, int]]:
    """Returns how many tasks were solved in a row, by policy and chain; none if there is no file.

    Raises:
        ConfigError: The file is damaged.
    """
    return {label: _solved(runs) for label, runs in read_runs(path).items()}


def _checked(runs: dict[str, list[dict[str, Any]]]) -> dict[str, list[dict[str, Any]]]:
    for items in runs.values():
        _solved(items)
    return runs


def _solved(runs: list[dict[str, Any]]) -> dict[int, int]:
    """Returns tasks solved in a row by chain, in the order of chains; of two runs, the later one's."""
    merged = {int(index): int(count) for run in runs for index, count in run["solved"].items()}
    return dict(sorted(merged.items()))

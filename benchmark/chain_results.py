"""Results of CALVIN's chains in a file: which run solved how much of which chain.

The file has a list of runs for each policy; a run has its command, commit and seed, and ``solved``, which has
the number of tasks that were solved in a row by the index of the chain.
"""

import json
from pathlib import Path
from typing import Any

from filelock import FileLock

from envs.core.atomic import write_errors, write_file
from envs.core.json_file import read_kept

FILE = "calvin_chains.json"
"""The file, in a folder of results."""


class ChainResults:
    """The results of one policy, kept chain by chain beside those of others.

    ``done`` has the chains of runs at the present commit and seed: others are run again.

    Args:
        path: The file.
        label: The policy.
        run: Facts of the present run: ``command``, ``git_sha`` and ``seed``.

    Raises:
        ConfigError: The file is damaged.
    """

    def __init__(self, path: Path, label: str, run: dict[str, Any]) -> None:
        self._path, self._label, self._facts = path, label, run
        self.done = _solved([each for each in read_runs(path).get(label, []) if self._is_own(each)])

    def add(self, index: int, count: int) -> None:
        """Keeps how many tasks of a chain were solved in a row; other processes may add at the same time.

        Raises:
            ConfigError: The file was damaged meanwhile.
            WriteError: The disk is full or the folder cannot be written.
        """
        self.done[index] = count
        with write_errors(self._path):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with FileLock(self._path.with_name(f".{self._path.name}.lock")):
                runs = read_runs(self._path)
                run = self._run_in(runs)
                solved = run["solved"] | {str(index): count}
                run["solved"] = {key: solved[key] for key in sorted(solved, key=int)}
                _write(self._path, runs)

    def _is_own(self, run: dict[str, Any]) -> bool:
        """Whether a run of the file had the same code and seed, so that this one continues it."""
        return _identity(run) == _identity(self._facts)

    def _run_in(self, runs: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
        """Returns the present run in those of a file, at their end where it has no result yet."""
        own = runs.setdefault(self._label, [])
        run = next((item for item in own if item == {**self._facts, "solved": item["solved"]}), None)
        if run is None:
            own.append(run := {**self._facts, "solved": {}})
        return run


def read_runs(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Returns the runs of each policy; none if there is no file.

    Raises:
        ConfigError: The file is damaged.
    """
    return read_kept(path, _checked, "has no results of chains", "Restore it, or remove it.") or {}


def read_results(path: Path) -> dict[str, dict[int, int]]:
    """Returns how many tasks were solved in a row, by policy and chain; none if there is no file.

    A policy's chains are those of one commit and seed: which have most chains, or of as many the later ones.
    One without any is left out.

    Raises:
        ConfigError: The file is damaged.
    """
    return {label: _solved(runs) for label, runs in fullest_runs(path).items()}


def fullest_runs(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Returns the runs of :func:`read_results` by policy, each with its command, commit and seed."""
    found = {label: _fullest(runs) for label, runs in read_runs(path).items()}
    return {label: runs for label, runs in found.items() if _solved(runs)}


def _fullest(runs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    of_code: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for run in runs:
        of_code.setdefault(_identity(run), []).append(run)
    return max(reversed(of_code.values()), key=lambda own: len(_solved(own)), default=[])


def _identity(run: dict[str, Any]) -> tuple[Any, ...]:
    """Returns what runs have in common whose chains belong together."""
    return run.get("git_sha"), run.get("seed")


def _write(path: Path, runs: dict[str, list[dict[str, Any]]]) -> None:
    lines = [
        f" {json.dumps(label)}: [\n  " + ",\n  ".join(json.dumps(run) for run in own) + "\n ]"
        for label, own in sorted(runs.items())
        if own
    ]
    write_file(path, ("{\n" + ",\n".join(lines) + "\n}\n").encode())


def _checked(runs: dict[str, list[dict[str, Any]]]) -> dict[str, list[dict[str, Any]]]:
    for items in runs.values():
        _solved(items)
    return runs


def _solved(runs: list[dict[str, Any]]) -> dict[int, int]:
    """Returns tasks solved in a row by chain, in the order of chains; of two runs, the later one's."""
    merged = {int(index): int(count) for run in runs for index, count in run["solved"].items()}
    return dict(sorted(merged.items()))

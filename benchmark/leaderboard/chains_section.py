"""CALVIN's chains on the board: one row a policy, by the average number of instructions solved in a row."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.chain_results import FILE, fullest_runs
from benchmark.statistics import stratified_bootstrap, wilson
from envs.tasks.calvin.sequences import CHAIN_LENGTH


def chain_rows(results_dir: Path) -> list[dict[str, Any]]:
    """Returns a row for each policy that ran chains, the longest average first; none without such results.

    Returns:
        Plain values: ``policy``, ``version`` (hashes of its weights and scene, where several rows have its
        name), ``is_baseline``, ``chains`` (how many), ``average_length``, ``ci_low`` and ``ci_high`` (95 %, a
        bootstrap over chains), ``rates`` (of at least 1 to 5 in a row, each with its interval), ``commands``
        and ``git_sha``, None outside a checkout.

    Raises:
        ConfigError: The file is damaged.
    """
    found = fullest_runs(results_dir / FILE)
    rows = [_row(label, runs) for label, runs in found.items()]
    number = Counter(row["policy"] for row in rows)
    for row in rows:
        row["version"] = row["version"] if number[row["policy"]] > 1 else ""
    return sorted(rows, key=lambda row: (-row["average_length"], row["policy"]))


def _row(label: str, runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    solved = {index: count for run in runs for index, count in run["solved"].items()}
    counts = np.array([solved[index] for index in sorted(solved, key=int)], float)
    low, high = stratified_bootstrap([counts], seed=0)
    # A checkpoint's label ends with hashes of its weights and scene, a baseline's with one of another scene.
    is_baseline = label.count(" ") < 2
    policy, *hashes = label.split(" ") if is_baseline else label.rsplit(" ", 2)
    return {
        "policy": policy,
        "version": " ".join(hashes),
        "is_baseline": is_baseline,
        "chains": len(counts),
        "average_length": float(counts.mean()),
        "ci_low": low,
        "ci_high": high,
        "rates": [_rate(int((counts >= least).sum()), len(counts)) for least in range(1, CHAIN_LENGTH + 1)],
        "commands": [run["command"] for run in runs],
        "git_sha": runs[0]["git_sha"],
    }


def _rate(successes: int, count: int) -> dict[str, Any]:
    low, high = wilson(successes, count)
    rate = successes / count
    return {"success_rate": rate, "ci_low": low, "ci_high": high, "successes": successes, "episodes": count}

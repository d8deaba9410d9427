"""The learning curves of one section of the leaderboard: one per recipe, over its training seeds.

Where a training stopped does not change how it began, so that seeds which stopped after different steps or
seconds are different rows of results and one curve, over the environment steps that all of them reached.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.leaderboard.rows import Entry, name_rows, policy_label, row_key
from benchmark.learning_curves import over_seeds, read_curve
from benchmark.records import Result
from envs.core.fingerprint import canonical_json

_NOT_LEARNED_FROM = ("training_steps", "training_time_s", "protocol_hash", "tested_alone")
"""Fields that distinguish results without affecting learning."""


@dataclass(frozen=True, slots=True)
class _Training:
    """A run and its curve; ``row`` is the index of its row of results."""

    row: int
    path: str
    result: Result
    curve: np.ndarray


def learning_curves(results_dir: Path, rows: Sequence[Sequence[Entry]]) -> list[dict[str, Any]]:
    """Returns the learning curves of a section, in the order of its rows.

    Args:
        results_dir: Folder of results, where the curves of the runs are.
        rows: The runs of every row, in the order of the rows; runs without a curve are left out.

    Returns:
        Of every recipe its ``label``, the index ``row`` of its first row, its ``seeds`` and ``runs``, and
        what :func:`benchmark.learning_curves.over_seeds` has.

    Raises:
        ResultError: A file is no learning curve.
    """
    recipes = list(_recipes(_trainings(results_dir, rows)))
    keys = [_recipe(trainings[0].result) for trainings in recipes]
    found: list[dict[str, Any]] = [
        {
            "label": policy_label(trainings[0].result),
            "row": min(each.row for each in trainings),
            "seeds": [each.result.seed for each in trainings],
            "runs": [{"path": each.path, "run": each.result.run} for each in trainings],
            **over_seeds([each.curve for each in trainings]),
        }
        for trainings in recipes
    ]
    labelled = [{**key, **curve} for key, curve in zip(keys, found, strict=True)]
    name_rows(labelled, [key["settings"] for key in keys])
    for curve, named in zip(found, labelled, strict=True):
        curve["label"] = named["label"]
    return sorted(found, key=lambda curve: curve["row"])


def _trainings(results_dir: Path, rows: Sequence[Sequence[Entry]]) -> Iterator[_Training]:
    """Yields every training that has a curve once, however often it was tested."""
    seen = set()
    for index, entries in enumerate(rows):
        for path, result in entries:
            curve = read_curve(results_dir / path)
            if curve is None or (result.seed, curve.tobytes()) in seen:
                continue
            seen.add((result.seed, curve.tobytes()))
            yield _Training(index, path, result, curve)


def _recipes(trainings: Iterable[_Training]) -> Iterator[list[_Training]]:
    """Yields the trainings of every recipe, ordered by seed.

    A second training of a seed is no new sample, and one that ended before another logged anything has
    nothing in common with it: either begins a curve of its own.
    """
    groups: dict[str, list[list[_Training]]] = {}
    for training in sorted(trainings, key=lambda each: (each.result.seed, each.result.created, each.path)):
        bands = groups.setdefault(canonical_json(_recipe(training.result)), [])
        band = next((band for band in bands if _fits(training, band)), None)
        if band is None:
            bands.append([training])
        else:
            band.append(training)
    for bands in groups.values():
        yield from bands


def _fits(training: _Training, band: Sequence[_Training]) -> bool:
    curves = [training.curve, *(each.curve for each in band)]
    overlap = max(curve[0, 0] for curve in curves) <= min(curve[-1, 0] for curve in curves)
    return overlap and all(each.result.seed != training.result.seed for each in band)


def _recipe(result: Result) -> dict[str, Any]:
    """Returns what trainings of one curve share: everything but the seed and where they stopped."""
    key = {name: value for name, value in row_key(result).items() if name not in _NOT_LEARNED_FROM}
    learned = {name: value for name, value in key["settings"].items() if name != "materials"}
    return key | {"settings": learned}

"""Which results are entries of the board, and which are studies.

An **entry** is one budget, the same for every task, and demonstrations of the expert: a recipe, or a named
preset. A preset counts where its
keys were left as they are, or where two tasks or more learned with one budget at one level. Everything else
that was trained is a **study**: other numbers of demonstrations or steps, ablations, a task that was not
learned, a checkpoint of another program. A recipe of several tasks of a set such as ``grasp/`` is an entry in
the unseen tasks of that set, too, which they are for. A **baseline** was not trained. Success decides none of
this.
"""

import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from benchmark.leaderboard.recipe_settings import unusual_settings
from benchmark.leaderboard.rows import (
    demonstrated_by,
    is_of_other_task,
    policy_and_backend,
    steps_per_look,
    trained_with,
    training_length,
)
from benchmark.records import Result
from envs.core.fingerprint import canonical_json, digest

ENTRY, STUDY, BASELINE = "entry", "study", "baseline"

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+=-]{0,119}")

_LEAST_TASKS = 2
"""So many tasks make a changed preset a budget of the board."""

_UNCHANGING = {
    *("policy", "task", "tasks", "preset", "level", "seed", "backend", "device", "run", "resume", "slow_ok"),
    *("datasets_dir", "runs_dir", "results_dir", "num_workers", "num_envs", "num_threads", "compile"),
    *("cuda_graphs", "save_every", "log_every", "wandb", "videos", "levels", "splits", "episodes", "alone"),
    *("plugins", "tasks_at_once"),
}
"""Keys, without their group, that change neither the data nor the training of a preset."""


@dataclass(frozen=True, slots=True)
class BoardEntry:
    """One row of the board.

    Attributes:
        id: Identifies it, in names of HTML elements too.
        policy: Name of the policy.
        label: Policy, backend, and how many tasks one network learned, of which family.
        kind: ``"recipe"`` or ``"preset"``.
        name: Name of the recipe, version included, or of the preset.
        learned_from: ``"demonstrations"`` or ``"reward"``.
        demonstrations: Demonstrations per task, or None.
        steps: Gradient steps, or environment steps of reinforcement learning; None where a clock ended it.
        time_s: Seconds after which a clock ended the training, or None.
        image_size: Height and width of the images, pixels, or None.
        variant: Which of the entries that differ in nothing else shown here, from 1; 0 where there is one.
    """

    id: str
    policy: str
    label: str
    kind: str
    name: str
    learned_from: str
    demonstrations: int | None
    steps: int | None
    time_s: float | None
    image_size: int | None
    variant: int = 0

    def to_json(self) -> dict[str, Any]:
        """Returns plain JSON values."""
        return asdict(self)


def classify(results: Sequence[Result], train: Mapping[str, Any]) -> list[tuple[str, BoardEntry | None]]:
    """Returns the kind of each result, ``entry``, ``study`` or ``baseline``, and the entry that it is of.

    Args:
        results: All results of a folder.
        train: Defaults of the training.
    """
    keys = [_budget_key(result, train) for result in results]
    tasks: dict[tuple[str, int | None], set[str]] = {}
    unchanged: set[str] = set()
    for key, result in zip(keys, results, strict=True):
        if key is not None:
            tasks.setdefault((key, result.train_level), set()).add(result.env.task)
            if not result.recipe and _is_unchanged(result.command):
                unchanged.add(key)
    found: list[tuple[str, BoardEntry | None]] = []
    for key, result in zip(keys, results, strict=True):
        if is_baseline(result):
            found.append((BASELINE, None))
        elif key is None or result.train_level is None:
            found.append((STUDY, None))
        elif result.recipe or key in unchanged or len(tasks[key, result.train_level]) >= _LEAST_TASKS:
            found.append((ENTRY, _entry(key, result)))
        else:
            found.append((STUDY, None))
    return found


def is_baseline(result: Result) -> bool:
    """Returns whether nothing was trained."""
    return (
        result.checkpoint.hash is None
        and result.dataset_hash is None
        and not trained_with(result).get("train")
    )


def is_foreign(result: Result) -> bool:
    """Returns whether a checkpoint's training is not recorded here, as that of another program's is not."""
    return not is_baseline(result) and "train" not in trained_with(result) and not result.recipe


def _is_of_its_set(result: Result) -> bool:
    """Returns whether a recipe of several tasks was tested in another one of their set, as in ``grasp/``."""
    sets = {task.partition("/")[0] for task in (result.env.task, *result.train_tasks)}
    in_a_set = "/" in result.env.task and len(sets) == 1
    return bool(result.recipe) and len(result.train_tasks) > 1 and in_a_set


def _budget_key(result: Result, train: Mapping[str, Any]) -> str | None:
    """Returns what the results of one entry share, whatever the task, level and seed; None for studies."""
    trained = trained_with(result)
    preset = trained.get("preset")
    if is_of_other_task(result) and not _is_of_its_set(result):
        return None
    if result.recipe:
        return canonical_json(["recipe", result.policy, result.recipe, sorted(result.train_tasks)])
    has_preset = isinstance(preset, str) and _NAME.fullmatch(preset)
    if demonstrated_by(result) or is_foreign(result) or not has_preset:
        return None
    shared = {
        "tasks": sorted(result.train_tasks),
        "demonstrations": result.demonstrations,
        "cameras": trained.get("cameras"),
        "image_size": trained.get("image_size") if result.sees_images else None,
        "simulator": [trained.get(key) for key in ("simulator", "renderer", "simulator_settings")],
        "changed": [trained.get(key) or None for key in ("scenario", "materials")],
        "settings": unusual_settings(result.policy, trained.get("policy"), trained.get("train"), train),
        **training_length(result),
    }
    if steps := steps_per_look(result):  # without it an entry keeps its id
        shared["steps_per_look"] = steps
    return canonical_json(["preset", result.policy, preset, shared])


def _is_unchanged(command: str) -> bool:
    """Returns whether a recorded command trains a preset as it is."""
    try:
        _, script, *words = shlex.split(command)
    except ValueError:  # too short, or an open quotation mark
        return False
    keys = [word.partition("=")[0].rpartition(".") for word in words]
    return script.endswith("train.py") and all(
        group in ("", "collect", "train", "evaluate") and name in _UNCHANGING for group, _, name in keys
    )


def _entry(key: str, result: Result) -> BoardEntry:
    length: Mapping[str, Any] = training_length(result)
    kind = "recipe" if result.recipe else "preset"
    name = result.recipe or trained_with(result)["preset"]
    return BoardEntry(
        id=re.sub(r"[^a-z0-9]+", "-", f"{result.policy}-{name}".lower()).strip("-") + f"-{digest(key)[:6]}",
        policy=result.policy,
        label=policy_and_backend(result) + _learned_together(result.train_tasks),
        kind=kind,
        name=name,
        learned_from="reward" if result.demonstrations is None else "demonstrations",
        demonstrations=result.demonstrations,
        steps=length["training_steps"],
        time_s=length["training_time_s"],
        image_size=result.env.image_size if result.sees_images else None,
    )


def _learned_together(tasks: Sequence[str]) -> str:
    """Returns how many tasks one network learned, and of which family if all are of one."""
    families = {task.rpartition("/")[0] for task in tasks}
    of_one = f" of {families.pop()}" if len(families) == 1 and families != {""} else ""
    return f", {len(tasks)} tasks{of_one} in one" if tasks else ""


def shown_entries(entries: Iterable[BoardEntry]) -> dict[str, dict[str, Any]]:
    """Returns entries by id as plain JSON values, numbered where they would look the same."""
    alike: dict[BoardEntry, list[BoardEntry]] = {}
    for entry in sorted(set(entries), key=lambda entry: entry.id):
        alike.setdefault(replace(entry, id=""), []).append(entry)
    numbered = [
        replace(entry, variant=number if len(group) > 1 else 0)
        for group in alike.values()
        for number, entry in enumerate(group, 1)
    ]
    return {entry.id: entry.to_json() for entry in sorted(numbered, key=lambda entry: entry.id)}


def one_row_each(rows: Iterable[dict[str, Any]]) -> None:
    """Keeps one row of each entry, level and place of training; others of it become studies, in place.

    The one with most seeds stays, then with most test episodes, then the oldest: a run that is repeated does
    not replace the first.
    """
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in rows:
        if row["kind"] == ENTRY:
            key = row["entry"], row["train_level"], row["transferred_from"]
            groups.setdefault(key, []).append(row)
    for group in groups.values():
        first, *others = sorted(group, key=_weight)
        del first
        for row in others:
            row["kind"], row["entry"] = STUDY, None


def _weight(row: Mapping[str, Any]) -> tuple[Any, ...]:
    levels = [cell for cell in row["cells"] if cell["split"] == "test" and cell["level"] is not None]
    episodes = sum(cell["episodes"] for cell in levels)
    return -len(row["seeds"]), -episodes, min(run["created"] for run in row["runs"]), row["runs"][0]["path"]

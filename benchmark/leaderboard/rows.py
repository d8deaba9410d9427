"""One row of the leaderboard: the runs of one method, which differ in their training seed alone."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from benchmark.leaderboard.recipe_settings import differing, learned_settings, said
from benchmark.protocol import Cell
from benchmark.records import EpisodeRecord, Result, by_cell
from benchmark.results import video_dir
from benchmark.statistics import iqm, iqm_of_strata, mean_of_rates, rate_of_runs, stratified_bootstrap
from envs.core.fingerprint import canonical_json

Entry = tuple[str, Result]
"""A results file's path, relative to the folder of results, and what it holds."""

_VIDEO = re.compile(r"(?P<condition>.+)-(?P<split>train|test)-(?P<episode>\d+)-(?P<outcome>success|failure)")
_LEAST_RUNS_FOR_IQM = 3
_NAMED_TASKS = 3

_DISTINGUISHING = {
    "recipe": "recipe {}",
    "train_level": "trained at level {}",
    "train_only": "trained on {} alone",
    "source": "{}",
    "demonstrations": "{} demonstrations",
    "training_steps": "{} steps",
    "training_time_s": "{:g} s of training",
    "cameras": "seen by {}",
    "image_size": "{} px",
    "episodes_per_cell": "{} episodes a cell",
    "tested_alone": "tested on single channels too",
}
"""Fields that distinguish rows of one policy, and their labels."""


def row_key(result: Result) -> dict[str, Any]:
    """Returns what the runs of one row share: everything but the training seed."""
    return {
        "policy": result.policy,
        "recipe": result.recipe or None,
        **_learned_with(result),
        **demonstrated_by(result),
        "transferred_from": transferred_from(result),
        "train_level": result.train_level,
        "train_only": result.train_only,
        "cameras": " and ".join(result.env.cameras) or None,
        "image_size": result.env.image_size if result.sees_images else None,
        "demonstrations": result.demonstrations,
        **training_length(result),
        "protocol_hash": result.protocol.hash,
        "tested_alone": ", ".join(result.protocol.only) or None,
        "settings": {
            **learned_settings(result.config.get("policy"), trained_with(result).get("train")),
            **_trained_in(result),
            "materials": result.env.materials or "built-in",
        },
    }


def _learned_with(result: Result) -> dict[str, Any]:
    """Returns the other tasks that the policy learned, sorted; nothing where it learned this one alone."""
    others = sorted(set(learned_tasks(result)) - {result.env.task})
    return {"learned_with": others} if others else {}


def learned_tasks(result: Result) -> tuple[str, ...]:
    """Returns the tasks that are known to be learned, that of the run where it was one.

    A run of a dataset that was given names a task to be evaluated in, whatever task the dataset is of.
    """
    trained = trained_with(result)
    task = None if trained.get("dataset") else trained.get("task")
    return result.train_tasks or ((task,) if isinstance(task, str) and task else ())


def is_of_other_task(result: Result) -> bool:
    """Returns whether a policy was tested in a task that it is known not to have learned."""
    learned = learned_tasks(result)
    return bool(learned) and result.env.task not in learned


def demonstrated_by(result: Result) -> dict[str, str]:
    """Returns the ``source`` of the demonstrations, as a word of a command; nothing where it is the expert.

    Of a dataset that was given it is the folder's name, such as ``dataset=corrections``.
    """
    trained = trained_with(result)
    dataset, source = str(trained.get("dataset") or ""), str(trained.get("source") or "expert")
    if dataset:
        return {"source": f"dataset={PurePath(dataset).name}"}
    return {} if source == "expert" else {"source": f"source={source}"}


def _trained_in(result: Result) -> dict[str, Any]:
    """Returns what was changed of the scene, the materials and the looks of the demonstrations."""
    trained = trained_with(result)
    return {
        "training materials": trained.get("materials") or "built-in",
        "training scenario": trained.get("scenario") or "as it is",
        "steps_per_look": steps_per_look(result),
    }


def steps_per_look(result: Result) -> int:
    """Returns the control steps after which the look of a demonstration changed; 0 where it stayed."""
    collect = trained_with(result).get("collect")
    return (collect.get("steps_per_look") or 0) if isinstance(collect, Mapping) else 0


def training_length(result: Result) -> dict[str, Any]:
    """Returns how long the policy was trained: seeds that stop by the clock stop after different steps."""
    train = trained_with(result).get("train")
    limit = train.get("time_limit_s") if isinstance(train, Mapping) else None
    step, steps = result.checkpoint.step, train.get("steps") if isinstance(train, Mapping) else None
    by_clock = limit is not None and (step is None or steps is None or step < steps)
    return {
        "training_steps": None if by_clock else step,
        "training_time_s": limit if by_clock else None,
    }


def trained_with(result: Result) -> Mapping[str, Any]:
    """Returns the configuration of the training, which a later evaluation keeps under ``run``."""
    run = result.config.get("run")
    return run if isinstance(run, Mapping) else result.config


def transferred_from(result: Result) -> str | None:
    """Returns where the policy was trained, if not where it was tested, to be read after "trained in".

    It is ``"mujoco, rendered with warp"``, ``"scenes with franka"`` where the tested robot is none of those
    that were learned, or both: ``"mujoco, rendered with warp, with franka"``.
    """
    trained = trained_with(result)
    simulator, renderer = trained.get("simulator"), trained.get("renderer")
    robots = " and ".join(map(str, result.config.get("learned_robots") or ()))
    if not simulator or not renderer or (simulator, renderer) == (result.env.simulator, result.env.renderer):
        return f"scenes with {robots}" if robots else None
    return f"{simulator}, rendered with {renderer}" + (f", with {robots}" if robots else "")


def group_runs(entries: Iterable[Entry]) -> list[list[Entry]]:
    """Groups runs that differ in their training seed alone, each group ordered by seed.

    A second run of the same seed is no new sample of the method: it begins a row of its own.
    """
    groups: dict[tuple[str, int], list[Entry]] = {}
    seen: dict[tuple[str, int], int] = {}
    for path, result in sorted(entries, key=lambda entry: (entry[1].seed, entry[1].created, entry[0])):
        key = canonical_json(row_key(result))
        replica = seen.get((key, result.seed), 0)
        seen[key, result.seed] = replica + 1
        groups.setdefault((key, replica), []).append((path, result))
    return list(groups.values())


def build_row(results_dir: Path, entries: list[Entry]) -> dict[str, Any]:
    """Returns the row of the runs of one method: its cells, its mean over the levels, its runs and videos.

    Args:
        results_dir: Folder of results, where videos are looked for.
        entries: The runs, ordered by seed.
    """
    first = entries[0][1]
    results = [result for _, result in entries]
    episodes = [by_cell(result.records) for result in results]
    early = any(result.protocol.width is not None for result in results)
    cells = [
        _cell(cell, [of_run[cell] for of_run in episodes], stopped_early=early)
        for cell in first.protocol.cells()
    ]
    test = [cell for cell in cells if cell["split"] == "test" and cell["level"] is not None]
    mean = mean_of_rates([_interval(cell) for cell in test]) if test else None
    key = row_key(first)
    del key["settings"]
    return {
        "label": policy_label(first),
        **key,
        "episodes_per_cell": first.protocol.episodes,
        "seeds": [result.seed for _, result in entries],
        "cells": cells,
        "mean_test": dict(zip(("success_rate", "ci_low", "ci_high"), mean, strict=True)) if mean else None,
        "iqm_test": _iqm_over_runs(first.protocol.cells(), episodes),
        "runs": [_run(path, result) for path, result in entries],
        "videos": [video for path, _ in entries for video in _videos(results_dir, path)],
    }


def policy_and_backend(result: Result) -> str:
    """Returns the policy's name, and whose implementation was trained: ``ppo by rsl_rl``."""
    own = result.config.get("policy")
    backend = own.get("backend") if isinstance(own, Mapping) else None
    return f"{result.policy} by {backend}" if backend else result.policy


def policy_label(result: Result) -> str:
    """Returns the policy's name, whose implementation was trained, and which other tasks it learned."""
    label = policy_and_backend(result)
    others = _learned_with(result).get("learned_with", [])
    if not others:
        return label
    how, kind = ("trained on", "other") if is_of_other_task(result) else ("learned with", "further")
    many = len(others) > _NAMED_TASKS
    return f"{label}, {how} {f'{len(others)} {kind} tasks' if many else ' and '.join(others)}"


def _run(path: str, result: Result) -> dict[str, Any]:
    return {
        "path": path,
        "run": result.run,
        "seed": result.seed,
        "created": result.created,
        "git": asdict(result.git) if result.git else None,
        "command": result.command,
        "machine": asdict(result.machine),
        "versions": dict(result.versions),
        "dataset_hash": result.dataset_hash,
        "checkpoint": asdict(result.checkpoint),
    }


def _cell(cell: Cell, members: list[list[EpisodeRecord]], *, stopped_early: bool) -> dict[str, Any]:
    """Returns the summary of a cell of which each run has some episodes."""
    rate, low, high = rate_of_runs([_successes(records) for records in members], stopped_early=stopped_early)
    flat = [record for records in members for record in records]
    return {
        "level": cell.level,
        "only": cell.only,
        "split": cell.split,
        "channels": list(flat[0].channels),
        "not_shown": sorted({name for record in flat for name in record.not_shown}),
        "episodes": len(flat),
        "successes": sum(record.success for record in flat),
        "success_rate": rate,
        "ci_low": low,
        "ci_high": high,
        "mean_length": float(np.mean([record.length for record in flat])),
    }


def _successes(records: Iterable[EpisodeRecord]) -> np.ndarray:
    return np.array([record.success for record in records], dtype=float)


def _interval(cell: Mapping[str, Any]) -> tuple[float, float, float]:
    return cell["success_rate"], cell["ci_low"], cell["ci_high"]


def _iqm_over_runs(
    cells: Iterable[Cell], episodes: list[dict[Cell, list[EpisodeRecord]]]
) -> dict[str, float] | None:
    """Returns the interquartile mean over runs and levels of the test split, or None for too few runs."""
    tested = [cell for cell in cells if cell.split == "test" and cell.level is not None]
    if len(episodes) < _LEAST_RUNS_FOR_IQM or not tested:
        return None
    scores = [np.array([_successes(of_run[cell]).mean() for of_run in episodes]) for cell in tested]
    low, high = stratified_bootstrap(scores, iqm_of_strata, seed=0)
    return {"success_rate": iqm(np.stack(scores)), "ci_low": low, "ci_high": high}


def _videos(results_dir: Path, path: str) -> list[dict[str, Any]]:
    found = []
    for video in sorted(video_dir(results_dir / path).glob("*.mp4")):
        match = _VIDEO.fullmatch(video.stem)
        if match is None:
            continue
        poster = video.with_suffix(".png")
        found.append(
            {
                **match.groupdict(),
                "episode": int(match["episode"]),
                "path": video.relative_to(results_dir).as_posix(),
                "poster": poster.relative_to(results_dir).as_posix() if poster.exists() else None,
            }
        )
    return found


def name_rows(rows: Sequence[dict[str, Any]], settings: Sequence[Mapping[str, Any]]) -> None:
    """Names every row in place: policy, where it was transferred from, and what else distinguishes it.

    Args:
        rows: Rows of one section, or its learning curves, which have a row's keys as far as they concern
            learning.
        settings: The settings that decided what each of them learned.
    """
    for row in rows:
        if row["transferred_from"] is not None:
            row["label"] += f", trained in {row['transferred_from']}"
    for name, text in _DISTINGUISHING.items():
        for group in _of_one_label(rows):
            if len({rows[index].get(name) for index in group}) > 1:
                for row in (rows[index] for index in group):
                    row["label"] += ", " + text.format(row[name]) if row.get(name) is not None else ""
    for group in _of_one_label(rows):
        _name_by_settings([rows[index] for index in group], [settings[index] for index in group])
    for group in _of_one_label(rows):
        for row in (rows[index] for index in group):
            row["label"] += f", {row['runs'][0]['run']}"


def _of_one_label(rows: Sequence[Mapping[str, Any]]) -> list[list[int]]:
    """Returns the rows that have their label in common with others, together."""
    same: dict[str, list[int]] = {}
    for index, row in enumerate(rows):
        same.setdefault(row["label"], []).append(index)
    return [group for group in same.values() if len(group) > 1]


def _name_by_settings(rows: Sequence[dict[str, Any]], settings: Sequence[Mapping[str, Any]]) -> None:
    """Distinguishes rows of one label by as few of their settings as possible."""
    candidates = differing(settings)
    for key in candidates:
        for group in _of_one_label(rows):
            if key in differing([settings[index] for index in group]):
                for index in group:
                    rows[index]["label"] += ", " + said(key, settings[index][key], candidates)


def rank(row: Mapping[str, Any]) -> tuple[Any, ...]:
    """Orders rows by how many levels they were tested at, then by the mean over them."""
    tested = sum(cell["split"] == "test" and cell["level"] is not None for cell in row["cells"])
    mean = row["mean_test"]["success_rate"] if row["mean_test"] else 0.0
    return -tested, -mean, row["label"], row["runs"][0]["path"]

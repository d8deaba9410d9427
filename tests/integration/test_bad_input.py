"""Damaged datasets, checkpoints and results through the commands: one message, exit code 2, no trace."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from policies.checkpoint import CONFIG, PREPROCESSOR, WEIGHTS
from roboverse_learn import cli
from tests.integration.main_run import TINY, MainRun

pytestmark = pytest.mark.slow

Damage = Callable[[Path], Any]

SCENE = ("task=PickCube", "image_size=32", "cameras=[front]")


def halve(pattern: str) -> Damage:
    """Cuts the first file of a pattern to half its length, as an interrupted copy does."""

    def damage(root: Path) -> None:
        path = sorted(root.glob(pattern))[0]
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])

    return damage


def remove(pattern: str) -> Damage:
    return lambda root: [path.unlink() for path in sorted(root.glob(pattern))[:1]]


def change(name: str, **values: Any) -> Damage:
    """Sets keys of a JSON file."""

    def damage(root: Path) -> None:
        path = root / name
        path.write_text(json.dumps(json.loads(path.read_text()) | values))

    return damage


def snapshot(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != ".lock"
    }


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (halve("videos/**/*.mp4"), ".mp4"),
        (remove("videos/**/*.mp4"), ".mp4"),
        (halve("data/**/*.parquet"), ".parquet"),
        (halve("meta/episodes/**/*.parquet"), ".parquet"),
        (lambda root: shutil.rmtree(root / "meta/episodes"), "meta/episodes"),
        (halve("meta/info.json"), "info.json"),
        (change("meta/info.json", codebase_version="v2.1"), "v2.1"),
        (remove("raw/episode_000001.safetensors"), "episode_000001"),
        (halve("raw/episode_000001.safetensors"), "episode_000001"),
    ],
    ids=["video", "no-video", "frames", "episodes", "no-episodes", "info", "version", "no-raw", "raw"],
)
def test_a_damaged_dataset_is_named(
    main_run: MainRun, tmp_path: Path, error: Callable[[list[str]], str], damage: Damage, named: str
) -> None:
    copy = tmp_path / "demos"
    shutil.copytree(main_run.dataset, copy)
    damage(copy)
    before = snapshot(copy)
    folders = [f"runs_dir={tmp_path / 'runs'}", f"results_dir={tmp_path / 'results'}"]
    said = error(["train", *TINY, f"dataset={copy}", *folders])
    assert named in said and str(copy) in said
    assert snapshot(copy) == before  # what can still be saved is not touched
    assert not (tmp_path / "results").exists()
    assert not list((tmp_path / "runs").rglob("*.safetensors"))


def test_statistics_that_are_lost_are_made_again(main_run: MainRun, tmp_path: Path) -> None:
    copy = tmp_path / "demos"
    shutil.copytree(main_run.dataset, copy)
    (copy / "meta/stats.json").unlink()
    words = [*SCENE, "num_demos=4", "collect.num_workers=1", f"dataset={copy}"]
    assert cli.main(["collect", *words]) == 0
    assert snapshot(copy) == snapshot(main_run.dataset)


@pytest.mark.parametrize(
    ("key", "value"),
    [("level", "3"), ("image_size", "64"), ("task_kwargs.variant", "lift")],
)
def test_a_dataset_of_another_scene_is_not_continued(
    main_run: MainRun, tmp_path: Path, error: Callable[[list[str]], str], key: str, value: str
) -> None:
    copy = tmp_path / "demos"
    shutil.copytree(main_run.dataset, copy)
    before = snapshot(copy)
    words = [*SCENE, "num_demos=5", "collect.num_workers=1", f"{key}={value}"]
    said = error(["collect", f"dataset={copy}", *words])
    assert str(copy) in said and value in said
    assert snapshot(copy) == before


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (halve(WEIGHTS), WEIGHTS),
        (remove(WEIGHTS), WEIGHTS),
        (halve(CONFIG), CONFIG),
        (change(CONFIG, input_features={"observation.images.front": {"type": "VISUAL"}}), "shape"),
        (remove(CONFIG), CONFIG),
        (change(CONFIG, type="dreamer"), "dreamer"),
        (change(CONFIG, dim_model=48), "does not fit"),
        (change(CONFIG, n_action_steps=500), "n_action_steps"),
        (remove(PREPROCESSOR), PREPROCESSOR),
        (halve("*normalizer*.safetensors"), "normalizer"),
        (change(PREPROCESSOR, steps=[{"class": "os.system", "config": {}}]), PREPROCESSOR),
    ],
    ids=[
        *(
            "weights",
            "no-weights",
            "config",
            "no-shape",
            "no-config",
            "unknown-policy",
            "other-size",
            "wrong-value",
        ),
        *("no-processor", "statistics", "foreign-code"),
    ],
)
def test_a_broken_checkpoint_is_named(
    main_run: MainRun, tmp_path: Path, error: Callable[[list[str]], str], damage: Damage, named: str
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(main_run.checkpoint, copy)
    damage(copy)
    words = ["task=PickCube", "image_size=32", "device=cpu", "levels=[0]", "splits=[test]", "episodes=1"]
    said = error(["evaluate", f"checkpoint={copy}", f"results_dir={tmp_path / 'results'}", *words])
    assert named in said and "copy" in said
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"schema_version": 99}, "schema version 99; this release reads 1"),
        ({"schema_version": "1"}, "schema version '1'"),
        ({"cells": []}, "does not follow schema 3: at cells"),
        ({"seed": 7}, "digest"),
        ({"protocol_hash": "0" * 16}, "hashes to"),
        ({"surprise": 1}, "surprise"),
    ],
)
def test_a_results_file_that_was_changed_stops_the_leaderboard(
    main_run: MainRun,
    tmp_path: Path,
    error: Callable[[list[str]], str],
    changed: dict[str, Any],
    named: str,
) -> None:
    path = tmp_path / main_run.result.relative_to(main_run.folder / "results")
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(json.loads(main_run.result.read_text()) | changed))
    said = error(["leaderboard", f"results_dir={tmp_path}"])
    assert named in said and path.name in said
    assert "Move the file away and evaluate the checkpoint again" in said  # every message says what to do
    assert list(tmp_path.rglob("leaderboard.*")) == []


def test_a_broken_training_state_is_named_and_the_checkpoint_is_kept(
    main_run: MainRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Callable[[list[str]], str]
) -> None:
    monkeypatch.chdir(main_run.folder)
    runs = tmp_path / "runs"
    shutil.copytree(main_run.folder / "runs", runs, symlinks=True)
    (state,) = runs.rglob("training_state/state.safetensors")
    state.write_bytes(state.read_bytes()[:1000])
    words = [f"runs_dir={runs}", f"results_dir={tmp_path / 'results'}", "train.steps=14"]
    # The same run with more steps resumes from its last checkpoint, which is damaged.
    run = next((runs / "PickCube/act").iterdir())
    said = error(["train", *TINY, f"run={run}", *words])
    assert "training_state' cannot be read" in said and "begin a new run" in said
    assert (run / "checkpoints/last/pretrained_model" / WEIGHTS).is_file()

"""Runs as ``roboverse list runs`` shows them."""

import json
import os
import time

import pytest

from roboverse_learn import cli
from roboverse_learn.commands.run_list import runs_in_detail

CELLS = [
    {"level": 0, "only": None, "split": "train", "success_rate": 1.0},
    {"level": 0, "only": None, "split": "test", "success_rate": 0.9},
    {"level": 3, "only": None, "split": "test", "success_rate": 0.25},
    {"level": 3, "only": "camera", "split": "test", "success_rate": 0.0},
    {"level": 0, "only": None, "split": "test", "success_rate": 0.0, "instruction_test": "wrong"},
]


@pytest.fixture
def runs(tmp_path):
    return tmp_path / "runs"


def write(folder, status, stages, *, steps=100, written_s_ago=0.0):
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text("policy_name: act\n")
    manifest = {"status": status, "stages": stages, "config": {"train": {"steps": steps}}}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    for path in folder.iterdir():
        then = time.time() - written_s_ago
        os.utime(path, (then, then))


def cells_of(text):
    """Returns the cells of each row but the heading, split where two spaces or more stand."""
    return [[cell.strip() for cell in row.split("  ") if cell.strip()] for row in text.splitlines()[1:]]


def test_a_run_that_is_done_is_shown_with_the_success_of_its_test_split(runs, tmp_path):
    result = tmp_path / "one.json"
    result.write_text(json.dumps({"cells": CELLS}))
    stages = {"train": {"status": "done", "steps": 2000}, "evaluate": {"results": [str(result)]}}
    write(runs / "PickCube" / "act" / "a", "done", stages, steps=2000, written_s_ago=75)
    assert cells_of(runs_in_detail(runs)) == [
        ["PickCube/act/a", "done", "2,000 of 2,000", "90, 25 % at levels 0, 3", "1:15 ago"]
    ]


def test_several_tasks_have_their_mean_and_another_split_stands_for_an_absent_test(runs, tmp_path):
    paths = [tmp_path / "one.json", tmp_path / "two.json"]
    for path, rate in zip(paths, (0.5, 1.0), strict=True):
        validation = CELLS[0] | {"split": "validation", "success_rate": rate}
        path.write_text(json.dumps({"cells": [CELLS[0], validation]}))
    stages = {"train": {"steps": 5}, "evaluate": {"results": [*map(str, paths), str(tmp_path / "gone.json")]}}
    write(runs / "many", "done", stages)
    assert cells_of(runs_in_detail(runs))[0][3] == "75 % at level 0, validation split"


def test_a_run_that_is_not_done_says_where_it_is_and_how_many_steps_it_has(runs):
    write(runs / "one", "running", {"collect": {"status": "done"}, "train": {"status": "running"}})
    (runs / "one" / "metrics.jsonl").write_text('{"step": 50}\n{"step": 60}\n{"st')
    error = {"status": "stopped", "error": "WriteError: " + "the disk\nis full, " * 9}
    write(runs / "two", "stopped", {"collect": error}, written_s_ago=60)
    one, two = cells_of(runs_in_detail(runs))
    assert one[:4] == ["one", "running in train", "60 of 100", "-"]
    assert two[1].startswith("stopped in collect: the disk is full, the") and two[1].endswith("…")
    assert two[2] == "0 of 100"


def test_a_run_that_is_continued_is_where_it_is_now(runs):
    done = {"status": "done"}
    stages = {
        "collect": done,
        "train": {"status": "running", "steps": 2000},
        "evaluate": done,
        "leaderboard": done,
    }
    write(runs / "more", "running", stages, steps=4000)
    (runs / "more" / "metrics.jsonl").write_text('{"step": 3500}\n')
    assert cells_of(runs_in_detail(runs))[0][1:3] == ["running in train", "3,500 of 4,000"]
    stages["train"] |= {"status": "stopped", "error": "Interrupted: by SIGTERM"}
    (runs / "more" / "manifest.json").write_text(
        json.dumps({"status": "stopped", "stages": stages, "config": {"train": {"steps": 4000}}})
    )
    assert cells_of(runs_in_detail(runs))[0][1] == "stopped in train: by SIGTERM"


def test_steps_that_are_not_known_hide_no_state(runs):
    write(runs / "timed", "done", {"train": {"status": "done"}})
    assert cells_of(runs_in_detail(runs))[0][1:4] == ["done", "-", "-"]


def test_runs_are_found_at_any_depth_newest_first_and_other_files_are_no_runs(runs):
    for name, age in (("old", 30), ("family/task/act/new", 3), ("middle", 10)):
        write(runs / name, "done", {}, written_s_ago=age)
    (runs / "other").mkdir()
    (runs / "other" / "manifest.json").write_text("{}")
    assert [row[0] for row in cells_of(runs_in_detail(runs))] == ["family/task/act/new", "middle", "old"]


def test_a_damaged_manifest_hides_no_other_run(runs):
    write(runs / "broken", "done", {})
    (runs / "broken" / "manifest.json").write_text("{")
    write(runs / "whole", "done", {}, written_s_ago=9)
    broken, whole = cells_of(runs_in_detail(runs))
    assert broken[1] == "its manifest is damaged" and whole[1] == "done"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["runs", "runs_dir=none"], "There is no folder 'none'"),
        (["runs", "tasks"], "Runs are listed alone"),
        (["runs", "datasets_dir=x"], "Unknown key of list runs 'datasets_dir'. Valid: runs_dir"),
        (["policies", "runs_dir=x"], "Unknown key of list 'runs_dir'."),
    ],
)
def test_what_cannot_be_listed_is_one_sentence(words, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["list", *words]) == 2
    assert said in capsys.readouterr().err


def test_an_empty_folder_has_none(runs, capsys):
    runs.mkdir()
    assert cli.main(["list", "runs", f"runs_dir={runs}"]) == 0
    assert "none in" in capsys.readouterr().out

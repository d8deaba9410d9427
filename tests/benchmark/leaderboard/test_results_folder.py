"""Which folder is one of results, and what is said of any other."""

import re
import shutil
from contextlib import nullcontext
from pathlib import Path

import pytest

from benchmark.leaderboard.build import write
from benchmark.leaderboard.results_folder import TABLES, check_results_folder, load_results
from envs.core.errors import ResultError


def refusal(folder):
    """What is said of a folder, which must not be changed."""
    before = sorted(folder.rglob("*"))
    with pytest.raises(ResultError) as caught:
        write(folder)
    assert sorted(folder.rglob("*")) == before
    return str(caught.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("meta/info.json", '{"codebase_version": "v3.0"}'),
        ("manifest.json", '{"status": "done"}'),
        ("model.safetensors", "weights"),
        ("report.json", "no JSON"),
    ],
)
@pytest.mark.parametrize("below", [".", "PickCube/level0"])
def test_a_folder_of_other_things_is_named_and_nothing_is_to_be_removed(tmp_path, name, content, below):
    kinds = {"meta/info.json": "dataset", "manifest.json": "run", "model.safetensors": "checkpoint"}
    file = tmp_path / below / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(content)
    said = refusal(tmp_path)
    assert f"'{tmp_path}' is not a folder of results: it " in said
    if name in kinds:
        holds = (
            f"it is a {kinds[name]}." if below == "." else f"it holds the {kinds[name]} '{tmp_path / below}'."
        )
        assert holds in said
    assert "Give the folder that roboverse evaluate writes to" in said
    assert not any(word in said.lower() for word in ("remove", "move", "delete"))


@pytest.mark.parametrize(
    ("files", "is_refused"),
    [
        ({}, False),
        ({"notes.txt": ""}, False),
        ({"v2/PickCube/act/run.json": "{"}, False),
        ({"leaderboard.json": "{}", "meta/info.json": "{}"}, False),
        ({"meta/info.json": "{}"}, True),
        ({"PickCube/act/run.json": "{}"}, True),
    ],
)
def test_results_are_not_written_into_a_folder_of_other_things(tmp_path, files, is_refused):
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content)
    check_results_folder(tmp_path / "absent")
    with pytest.raises(ResultError, match="is not a folder of results") if is_refused else nullcontext():
        check_results_folder(tmp_path)


def test_a_folder_without_json_names_what_it_holds(tmp_path):
    for name in ("a.py", "b.py", "c.py", "d.py", ".hidden"):
        (tmp_path / name).touch()
    assert "it holds 'a.py', 'b.py', 'c.py', … and no results." in refusal(tmp_path)


def test_a_file_of_others_among_results_stays_where_it_is(publish, tmp_path):
    publish()
    (tmp_path / "notes.json").write_text("{}")
    said = refusal(tmp_path)
    assert "notes.json' is not a results file: it has neither cells nor records." in said
    assert "keep other JSON files out of it" in said and "Move the file" not in said


def test_a_damaged_result_alone_is_a_result(publish, tmp_path):
    path = publish()
    path.write_bytes(path.read_bytes()[:300])
    assert "act-s0.json' is not a whole JSON file" in refusal(tmp_path)


@pytest.mark.parametrize("below", ["v2", "v2/PickCube"])
def test_a_folder_inside_the_results_names_the_folder_of_results(publish, tmp_path, below):
    publish()
    said = f"is not a folder of results: '{tmp_path}' is. Give results_dir={tmp_path} instead."
    assert said in refusal(tmp_path / below)
    with pytest.raises(ResultError, match=re.escape(said)):
        check_results_folder(tmp_path / below)


def test_the_folder_of_results_is_named_as_seen_from_the_working_folder(publish, tmp_path, monkeypatch):
    publish()
    for folder, given, root in ((tmp_path, "v2", "."), (tmp_path / "v2", ".", ".."), (tmp_path, ".", "")):
        monkeypatch.chdir(folder)
        with pytest.raises(ResultError, match=rf"Give results_dir={root} instead") if root else nullcontext():
            check_results_folder(Path(given))


def test_a_board_whose_results_are_gone_is_still_a_folder_of_results(publish, tmp_path):
    publish()
    write(tmp_path)
    shutil.rmtree(tmp_path / "v2")
    assert load_results(tmp_path) == []


def test_files_beside_the_results_of_the_repository_are_known():
    results = Path(__file__).parents[3] / "results"
    assert {path.name for path in results.glob("*.json")} <= set(TABLES)

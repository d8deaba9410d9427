"""On which page a new result is found."""

import json

import pytest

from benchmark.leaderboard.build import write
from benchmark.leaderboard.pages import pages_of


@pytest.fixture
def board(publish, tmp_path):
    """A board of an entry and a study, and a suite whose task has no section."""
    publish(run="entry")
    publish(run="study", task="StackCube", recipe="")
    path = write(tmp_path)["json"]
    values = json.loads(path.read_text())
    values["suites"] = [{"rows": [{"tasks": [{"path": "of_suite"}, {"path": None}]}]}]
    path.write_text(json.dumps(values))
    return path


@pytest.mark.parametrize(
    ("results", "pages"),
    [
        (["entry"], ["html"]),
        (["study"], ["studies html"]),
        (["study", "entry"], ["html", "studies html"]),
        (["of_suite"], ["html"]),
        (["elsewhere"], []),
        ([], []),
    ],
)
def test_a_study_is_on_the_studies_page_and_all_else_on_the_board(board, results, pages):
    rows = [row for section in json.loads(board.read_text())["sections"] for row in section["rows"]]
    paths = {run["run"]: run["path"] for row in rows for run in row["runs"]}
    assert pages_of(board, [paths.get(name, name) for name in results]) == pages


@pytest.mark.parametrize("content", [None, "{", "[]", "{}"])
def test_a_board_that_cannot_be_read_has_no_page(tmp_path, content):
    path = tmp_path / "leaderboard.json"
    if content is not None:
        path.write_text(content)
    assert pages_of(path, ["a"]) == []

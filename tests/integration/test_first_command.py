"""A short form of the README's first command learns: from pixels, to a success that no chance explains."""

import re
from pathlib import Path

import pytest

from benchmark.results import read_result
from roboverse_learn import cli

SHORT = (
    "num_demos=150",
    "train.steps=1200",
    "evaluate.levels=[0]",
    "evaluate.episodes=50",
    "evaluate.videos=0",
)
"""Two to three minutes on two cores."""

LEAST_SUCCESS = 0.3


@pytest.mark.long
def test_short_form_of_the_first_command_learns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    found = re.search(r"roboverse_learn/train\.py (policy=.* preset=quick)$", readme, re.MULTILINE)
    assert found, "README.md must hold the command that trains by preset=quick."
    monkeypatch.chdir(tmp_path)
    assert cli.main(["train", *found[1].split(), "device=cpu", *SHORT]) == 0
    (path,) = Path("results").glob("*/PickCube/act/*.json")
    (cell,) = read_result(path).cells()
    assert str(cell.cell) == "level 0, test split"
    assert cell.success_rate > LEAST_SUCCESS

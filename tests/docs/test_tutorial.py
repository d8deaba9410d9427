"""The tutorial's blocks run in their order, as printed."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs/tutorial.md"


@pytest.mark.slow
@pytest.mark.usefixtures("forked_workers")
def test_the_tutorial_collects_trains_and_evaluates(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        exec(compile(block, PAGE.name, "exec"), names)
    assert names["collection"].num_episodes == 4
    assert names["actions"].shape == (1, names["policy"].n_action_steps, 9)
    printed = capsys.readouterr().out
    assert "level0-test" in printed and "level3-test" in printed

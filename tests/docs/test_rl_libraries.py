"""The page of reinforcement learning libraries: its blocks run in their order, as printed."""

import re
from pathlib import Path

import pytest

import envs  # noqa: F401 (registers the ids where the plugin is not installed)

PAGE = Path(__file__).parents[2] / "docs/rl_libraries.md"


@pytest.mark.slow
def test_other_libraries_take_the_environments_as_they_are(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        exec(compile(block, PAGE.name, "exec"), names)
    assert names["model"].num_timesteps == 16
    assert names["rollout"]["agent_pos"].shape == (3, 9)
    assert "'agent_pos': (2, 9)" in capsys.readouterr().out

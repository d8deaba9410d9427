"""``plugins=[...]``: modules of a user, imported before a command looks anything up."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from envs.core.registry import PLUGINS_VARIABLE
from roboverse_learn import cli


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    (tmp_path / "plugin_of_a_user.py").write_text("import math\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(PLUGINS_VARIABLE, "")
    yield "plugin_of_a_user"
    sys.modules.pop("plugin_of_a_user", None)


@pytest.mark.parametrize("word", ["plugins=plugin_of_a_user", "plugins=[plugin_of_a_user]"])
def test_a_plugin_is_imported_here_and_named_to_other_processes(
    plugin: str, word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["list", word, "policies"]) == 0
    assert plugin in sys.modules and os.environ[PLUGINS_VARIABLE] == plugin
    assert "act" in capsys.readouterr().out


def test_several_plugins_join_those_of_the_environment_variable(
    plugin: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(PLUGINS_VARIABLE, "math")
    assert cli.main(["list", f"plugins=[json, {plugin}]", "policies"]) == 0
    assert os.environ[PLUGINS_VARIABLE] == f"math,json,{plugin}"


def test_a_plugin_that_cannot_be_imported_is_one_sentence(
    plugin: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["train", "plugins=no_such_module"]) == 2
    assert "error: The plugin 'no_such_module' cannot be imported" in capsys.readouterr().err


def test_a_plugin_that_is_given_twice_is_named_once(plugin: str) -> None:
    assert cli.main(["list", f"plugins=[{plugin},{plugin}]", f"plugins={plugin}", "policies"]) == 0
    assert os.environ[PLUGINS_VARIABLE] == plugin

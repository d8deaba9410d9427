"""``plugins=[...]``: modules of a user, imported before a command looks anything up."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from envs.core.registry import OF_YOUR_OWN, PLUGINS_VARIABLE
from policies.checkpoint import CONFIG, WEIGHTS
from roboverse_learn import cli, doctor
from roboverse_learn.commands.run_folder import RunFolder
from roboverse_learn.config.compose import compose

ROOT = Path(__file__).resolve().parents[3]


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


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A current folder that is not on the path."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(PLUGINS_VARIABLE, "")
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path not in ("", ".")])
    yield tmp_path
    for name in ("plugin_here", "empty_plugin", "another"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize("file", ["plugin_here.py", "plugin_here/__init__.py"])
@pytest.mark.parametrize("project", ["", "plugin_here"])
def test_a_plugin_of_the_current_folder_or_of_a_project_there_is_found(
    here: Path, project: str, file: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = here / project / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("HERE = True\n")
    assert cli.main(["list", "plugins=[plugin_here]", "policies"]) == 0, capsys.readouterr().err
    assert sys.modules["plugin_here"].__file__ == str(path)
    assert sys.path[-1] == str(here / project)  # behind all that is installed


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("plugins=[plugin_here.py]", "'plugin_here.py' cannot be imported"),
        (
            "plugins=[./plugin_here.py]",
            "is no name of a module. Write it as it is imported, .*=.plugin_here.",
        ),
        ("plugins=[my/plugin-here]", "is no name of a module"),
        (
            "plugins=[misspelt_plugin]",
            "NameError: name 'maths' is not defined.* python -c 'import miss",
        ),
        ("plugins=[empty_plugin]", "'empty_plugin' is a folder without __init__.py, which registers nothing"),
    ],
)
def test_a_file_a_path_and_an_empty_folder_are_no_plugins(
    here: Path, word: str, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "plugin_here.py").write_text("")
    (here / "empty_plugin").mkdir()
    (here / "misspelt_plugin.py").write_text("import math\nmaths.pi\n")
    monkeypatch.syspath_prepend(here)  # as `python -m` has it
    assert cli.main(["list", word, "policies"]) == 2
    assert re.search(said, capsys.readouterr().err)


@pytest.fixture
def misnamed(monkeypatch: pytest.MonkeyPatch) -> None:
    """An environment variable that names a plugin that is not there."""
    monkeypatch.setattr("envs.core.registry._LEFT_OUT", {})
    monkeypatch.setenv(PLUGINS_VARIABLE, "module_of_nobody")


_CANNOT = "The plugin 'module_of_nobody' cannot be imported: No module named 'module_of_nobody'."


@pytest.mark.parametrize(
    "words",
    [["train", "task=PickCube"], ["collect"], ["leaderboard"], ["speed", "env"], ["new", "task", "A"]],
)
def test_a_plugin_of_the_environment_variable_that_fails_is_one_sentence(
    misnamed: None, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(words) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and said[0].startswith(f"error: {_CANNOT}")
    assert said[0].endswith("The environment variable ROBOVERSE_PLUGINS names it.")


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        ([], "Usage: roboverse <command>"),
        (["--help"], "Usage: roboverse <command>"),
        (["help", "train"], "roboverse train: "),
        (["train", "--help"], "roboverse train: "),
        (["list", "tasks", "PickCube"], "PickCube"),
        (["--version"], "roboverse "),
    ],
)
def test_help_and_list_go_on_without_a_plugin_that_fails(
    misnamed: None, words: list[str], shown: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(words) == 0
    said = capsys.readouterr()
    assert shown in said.out and said.err.startswith(f"warning: {_CANNOT}") and said.err.count("\n") == 1


def test_doctor_lists_a_plugin_that_fails_and_its_processes_do_without(
    misnamed: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    parts = {name: part for name, part in doctor.PARTS.items() if name in ("plugins", "disk")}
    monkeypatch.setattr(doctor, "PARTS", parts)
    assert cli.main(["doctor"]) == 0
    said = capsys.readouterr()
    assert re.search(rf"^  cannot be imported +{re.escape(_CANNOT)}", said.out, re.MULTILINE)
    assert "Disk:" in said.out and said.err == "" and os.environ[PLUGINS_VARIABLE] == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "code", "out", "err"),
    [
        (["-m", "roboverse_learn", "--version"], 0, "^roboverse ", rf"^warning: {_CANNOT} .*\n$"),
        (["-m", "roboverse_learn", "train"], 2, "^$", rf"^error: {_CANNOT} .*\n$"),
        (
            ["-c", "import envs, gymnasium; print('RoboVerse/PickCube-v0' in gymnasium.registry)"],
            *(0, "^True\n$", rf"^{_CANNOT} .*\n$"),
        ),
    ],
)
def test_a_process_whose_environment_names_a_plugin_that_fails_has_no_traceback(
    words: list[str], code: int, out: str, err: str
) -> None:
    environment = {**os.environ, PLUGINS_VARIABLE: "module_of_nobody"}
    done = subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, env=environment, cwd=ROOT, check=False
    )
    assert done.returncode == code
    assert re.search(out, done.stdout) and re.search(err, done.stderr)


@pytest.fixture
def run_of_a_plugin(here: Path) -> Path:
    """A run of a policy that no module of this process registers."""
    config = compose("train", ["policy=act", "preset=quick", "device=cpu"])
    words = ["roboverse", "train", "policy=of_a_user", "plugins=[plugin_here, another]"]
    with RunFolder.open(config, words) as opened:
        checkpoint = opened.folder / "checkpoints/000100/pretrained_model"
        checkpoint.mkdir(parents=True)
        (checkpoint / CONFIG).write_text('{"type": "of_a_user"}')
        (checkpoint / WEIGHTS).write_bytes(b"weights")
    path = opened.folder / "config.yaml"
    path.write_text(path.read_text().replace("policy_name: act", "policy_name: of_a_user"))
    return opened.folder


@pytest.mark.parametrize("words", [["evaluate"], ["evaluate", "task=PickCube"], ["train"]])
def test_a_run_of_a_plugin_says_which_plugin_is_to_be_named(
    run_of_a_plugin: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    key = "run" if words == ["train"] else "checkpoint"
    assert cli.main([*words, f"{key}={run_of_a_plugin}"]) == 2
    said = capsys.readouterr().err
    assert "Unknown policy 'of_a_user'. Valid: act, " in said
    assert said.endswith(" was trained with plugins=[plugin_here,another]: add that.\n")


def test_a_run_asks_for_no_plugin_that_is_named_already(
    run_of_a_plugin: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("plugin_here", "another"):
        Path(f"{name}.py").write_text("")
    assert cli.main(["evaluate", f"checkpoint={run_of_a_plugin}", "plugins=[plugin_here]"]) == 2
    assert capsys.readouterr().err.endswith(" plugins=[another]: add that.\n")
    assert cli.main(["evaluate", f"checkpoint={run_of_a_plugin}", "plugins=[another]"]) == 2
    assert capsys.readouterr().err.endswith(f"{OF_YOUR_OWN}\n")
    (run_of_a_plugin / "manifest.json").write_text("{")
    monkeypatch.setenv(PLUGINS_VARIABLE, "")
    assert cli.main(["evaluate", f"checkpoint={run_of_a_plugin}"]) == 2
    assert capsys.readouterr().err.endswith(f"{OF_YOUR_OWN}\n")

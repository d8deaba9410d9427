"""``run=`` of a folder that is no run yet."""

import os
from pathlib import Path

import pytest

from roboverse_learn import train as command
from roboverse_learn.commands.new_run import new_run_words
from roboverse_learn.commands.run_folder import CONFIG_FILE
from roboverse_learn.config.compose import compose


@pytest.fixture(autouse=True)
def runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("quick-level0", "wide"):
        folder = Path("runs/PickCube/act") / name
        folder.mkdir(parents=True)
        (folder / CONFIG_FILE).touch()
    Path("runs/PickCube/act/notes").mkdir()


@pytest.mark.parametrize(
    ("run", "meant"),
    [
        ("runs/PickCube/act/quick-lvel0", "runs/PickCube/act/quick-level0"),
        ("runs/PickCub/act/quick-level0", "runs/PickCube/act/quick-level0"),
        ("run/PickCube/act/wide", "runs/PickCube/act/wide"),
    ],
)
def test_a_misspelt_run_begins_anew_and_the_one_that_may_be_meant_is_named(run, meant):
    said = f"run={run}: there is no run yet, so a new one begins. Did you mean '{meant}'?"
    assert new_run_words(run) == said


def test_folders_that_cannot_be_read_are_no_runs_and_no_mistake(monkeypatch):
    def refuse(path, *_, **__):
        raise PermissionError(13, "Permission denied", path)

    said = "run=runs/PickCube/act/wide2: there is no run yet, so a new one begins."
    with monkeypatch.context() as patch:
        patch.setattr("os.stat", refuse)
        assert not os.path.isfile("runs/PickCube/act/wide/config.yaml")
        patch.setattr("pathlib.Path.is_dir", lambda self: self.name == "act")
        patch.setattr("pathlib.Path.exists", lambda self: False)
        assert new_run_words("runs/PickCube/act/wide2") == said
        patch.setattr("os.listdir", refuse)
        assert new_run_words("runs/PickCube/act/wide2") == said


@pytest.mark.parametrize("run", ["mine", "runs/PickCube/act/quick-level1", "runs/PickCube/act/note", "runs"])
def test_a_new_name_begins_anew_without_a_guess(run):
    assert new_run_words(run) == f"run={run}: there is no run yet, so a new one begins."


@pytest.mark.parametrize("run", ["", "runs/PickCube/act/wide"])
def test_nothing_is_said_of_a_run_that_goes_on_or_is_not_named(run):
    assert new_run_words(run) == ""


def test_training_says_first_that_a_new_run_begins(caplog, monkeypatch):
    def timed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "refuse_long_run", timed)
    caplog.set_level("INFO")
    with pytest.raises(KeyboardInterrupt):
        command.train_run(compose("train", ["policy=act", "preset=quick", "run=runs/PickCube/act/wyde"]))
    assert "a new one begins. Did you mean 'runs/PickCube/act/wide'?" in caplog.text

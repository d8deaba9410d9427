"""``dry_run=true``: everything is checked and shown, and nothing is written."""

from pathlib import Path

import pytest
import yaml

from roboverse_learn import cli
from roboverse_learn.config.compose import compose
from roboverse_learn.config.serialize import to_values

WORDS = ("task=PickCube", "preset=quick", "device=cpu", "slow_ok=true")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[list[str], str]:
    """Returns the lines before the settings, and the settings."""
    assert cli.main(["train", *words, "dry_run=true"]) == 0, capsys.readouterr().err
    head, _, settings = capsys.readouterr().out.partition("\n\n")
    return head.splitlines(), settings


@pytest.mark.slow
def test_a_new_run_says_what_it_will_do_and_leaves_no_file(folder, capsys):
    head, settings = said(capsys, "policy=act", *WORDS, "num_demos=30", "levels=[0,3]", "episodes=5")
    assert not list(folder.iterdir())
    first, run, collect, train, evaluate = head
    assert first == "dry_run=true: nothing is written."
    assert run.split()[0] == "run" and run.endswith("(new)")
    assert "datasets/PickCube/level0" in collect and collect.endswith("(0 of 30 are there)")
    assert train.endswith("act on cpu: 6,000 steps of 32 samples")
    assert evaluate.endswith("levels=[0,3] splits=[test], 2 cells of 5 episodes into results")
    config = compose("train", ["policy=act", *WORDS, "num_demos=30", "levels=[0,3]", "episodes=5"])
    assert yaml.safe_load(settings) == to_values(config)


@pytest.mark.slow
def test_a_policy_that_learns_from_an_env_collects_nothing(folder, capsys):
    head, _ = said(capsys, "policy=ppo", *WORDS, "train.steps=5000", "simulator=mujoco")
    assert [line.split()[0] for line in head[1:]] == ["run", "train", "evaluate"]
    assert "ppo on cpu: 5,000 environment steps" in head[2]
    assert not list(folder.iterdir())


def test_what_stops_the_run_stops_its_dry_run(folder, capsys):
    (folder / "mine").mkdir()
    (folder / "mine/notes.txt").write_text("")
    words = ["policy=act", *WORDS, "run=mine", "train.time_limit_s=1", "dry_run=true"]
    assert cli.main(["train", *words]) == 2
    assert "'mine' is no run and holds other files, such as 'notes.txt'" in capsys.readouterr().err


def test_demonstrations_that_are_made_from_others_are_looked_for(folder, capsys):
    words = ["policy=act", *WORDS, "robot=ur5e", "source=retarget", "from=nowhere", "dry_run=true"]
    assert cli.main(["train", *words]) == 2
    assert "nowhere" in capsys.readouterr().err


def test_a_run_that_is_refused_as_long_is_shown_with_a_warning(folder, capsys, monkeypatch, caplog):
    from roboverse_learn.training.learners import learner_of

    words = ["policy=act", "task=PickCube", "device=cpu"]
    monkeypatch.setattr(type(learner_of(compose("train", words), "cpu")), "estimate_s", lambda self: 9e4)
    assert cli.main(["train", *words]) == 2
    assert "about 25 hours on this machine's CPU" in capsys.readouterr().err
    head, _ = said(capsys, *words)
    assert "about 25 hours on this machine's CPU" in caplog.text
    assert head[0] == "dry_run=true: nothing is written."
    assert not list(folder.iterdir())


def test_python_refuses_it_in_place_of_starting_the_run(folder):
    from envs.core.errors import ConfigError
    from roboverse_learn import api

    with pytest.raises(ConfigError, match="dry_run=true is of the command line"):
        api.train("act", "PickCube", preset="quick", dry_run=True)
    assert not list(folder.iterdir())


def test_it_names_no_other_run():
    from roboverse_learn.commands.run_identity import run_name

    plain, dry = (compose("train", ["policy=act", *WORDS, *more]) for more in ([], ["dry_run=true"]))
    assert run_name(plain) == run_name(dry)

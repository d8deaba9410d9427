"""``roboverse speed``: every name is a program, whose exit code is the command's. Nothing is timed."""

import subprocess
import sys
from types import SimpleNamespace

import pytest

from roboverse_learn import cli
from roboverse_learn.speed import PROGRAMS
from roboverse_learn.speed.harness import Program


@pytest.mark.parametrize("name", PROGRAMS.names())
def test_every_name_is_a_program(name: str) -> None:
    assert issubclass(PROGRAMS.get(name), Program)
    assert PROGRAMS.entry(name).summary


@pytest.mark.parametrize("command", ["speed", "benchmark"])
def test_programs_run_in_order_and_the_worst_exit_code_counts(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[list[str]] = []

    def fake(words: list[str], **_: object) -> SimpleNamespace:
        seen.append(words)
        return SimpleNamespace(returncode=int("startup" in words))

    monkeypatch.setattr(subprocess, "run", fake)
    assert cli.main([command, "startup", "dataset"]) == 1
    assert cli.main([command, "dataset", "size=64"]) == 0
    assert seen[0] == [sys.executable, "-m", "roboverse_learn.speed", "startup"]
    assert seen[-1][-1] == "size=64"


def test_names_are_checked_before_the_first_program_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: pytest.fail("a program was run"))
    assert cli.main(["speed", "dataset", "datset"]) == 2
    assert "Unknown speed program 'datset'. Did you mean 'dataset'?" in capsys.readouterr().err
    assert cli.main(["speed", "dataset", "startup", "size=64"]) == 2
    assert "'size=64' is a setting of one program, given 2 names" in capsys.readouterr().err


def test_help_lists_the_programs(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["speed", "--help"]) == 0
    said = capsys.readouterr().out
    assert all(f"  {name} " in said for name in PROGRAMS.names())

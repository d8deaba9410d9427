"""``roboverse benchmark``: every name runs a program, whose exit code is the command's. Nothing is timed."""

import importlib.util
import subprocess
import sys
from types import SimpleNamespace

import pytest

from roboverse_learn import cli
from roboverse_learn.speed import BENCHMARKS, run
from roboverse_learn.speed.startup import measure_startup


@pytest.mark.parametrize("name", BENCHMARKS.names())
def test_every_benchmark_is_a_program(name: str) -> None:
    spec = importlib.util.find_spec(str(BENCHMARKS.entry(name).target))
    assert spec is not None and spec.origin is not None
    with open(spec.origin, encoding="utf-8") as file:
        assert 'if __name__ == "__main__":' in file.read()
    assert BENCHMARKS.entry(name).summary


def test_the_benchmarks_named_run_in_order_and_the_worst_exit_code_counts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen: list[list[str]] = []

    def fake(command: list[str], **_: object) -> SimpleNamespace:
        seen.append(command)
        return SimpleNamespace(returncode=int("startup" in command[-1]))

    monkeypatch.setattr(subprocess, "run", fake)
    assert cli.main(["benchmark", "startup", "dataset"]) == 1
    assert cli.main(["benchmark", "dataset"]) == 0
    assert seen[0] == [sys.executable, "-m", "roboverse_learn.speed.startup"]
    assert run("startup") == 1


def test_a_name_is_checked_before_the_first_benchmark_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: pytest.fail("a benchmark was run"))
    assert cli.main(["benchmark", "dataset", "datset"]) == 2
    assert "Unknown benchmark 'datset'. Did you mean 'dataset'?" in capsys.readouterr().err


def test_the_help_lists_the_benchmarks(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["benchmark", "--help"]) == 0
    said = capsys.readouterr().out
    assert all(f"  {name} " in said for name in BENCHMARKS.names())


def test_a_measurement_of_startup_names_both_sides() -> None:
    measurement = measure_startup(("list",), turns=1)
    assert measurement.ours_s > 0 < measurement.baseline_s
    assert "roboverse list / an empty Python program" in str(measurement)

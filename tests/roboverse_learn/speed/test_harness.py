"""The harness of the speed programs, on a clock that the tests set."""

import contextlib
import json
from dataclasses import dataclass

import numpy as np
import pytest
import torch

from envs.core.errors import MissingExtraError, SimulatorError
from roboverse_learn.speed.harness import (
    DeviceProgram,
    Goal,
    Measurement,
    Program,
    compare,
    measurement,
    part,
    part_each,
    program,
    scaled,
    table,
)


class Clock:
    """A clock that its calls move."""

    now = 0.0

    def __call__(self) -> float:
        return self.now

    def takes(self, *seconds: float):
        left = iter(seconds)

        def call() -> None:
            self.now += next(left)

        return call


def test_sides_alternate_and_the_first_turn_is_dropped():
    clock, calls = Clock(), []
    found = compare("a", clock.takes(9, 1, 2), clock.takes(9, 3, 4), turns=2, clock=clock)
    assert (found.ours_s, found.baseline_s, found.ratio) == (1.5, 3.5, 2.5)  # 3 / 1 and 4 / 2
    note = {name: (lambda name=name: calls.append(name)) for name in ("ours", "theirs", "before", "after")}
    compare("a", note["ours"], note["theirs"], turns=1, before=note["before"], after=note["after"])
    assert calls == ["before", "theirs", "ours", "after", "before", "ours", "theirs", "after"]


def test_kernels_are_waited_for_within_the_timed_part(monkeypatch):
    clock, idle = Clock(), lambda: None
    waits = clock.takes(*range(8))
    monkeypatch.setattr(torch.cuda, "synchronize", lambda device: waits())
    found = compare("a", idle, idle, turns=1, clock=clock, device="cuda:1")
    assert (found.ours_s, found.baseline_s) == (5.0, 7.0)


def test_times_are_those_of_one_unit():
    clock, seconds = Clock(), [4.0] * 6
    found = compare("a", clock.takes(*seconds), clock.takes(*seconds), turns=1, calls=3, units=2, clock=clock)
    assert (found.ours_s, found.baseline_s) == (2.0, 2.0)


@pytest.mark.parametrize(
    ("goal", "ratio", "result", "text"),
    [
        (Goal(2.0), 3.0, "reached", "≥ 2.00"),
        (Goal(4.0), 3.0, "missed", "≥ 4.00"),
        (Goal(1.1, at_least=False), 1 / 3, "reached", "≤ 1.10"),
        (Goal(0.3, at_least=False), 1 / 3, "missed", "≤ 0.30"),
        (Goal(4.0, applies=False), 3.0, "-", "≥ 4.00 on a GPU"),
        (Goal(), 3.0, "-", "-"),
        (Goal(0.5, at_least=False, absolute=True), 1 / 3, "reached", "≤ 0.50 s"),
    ],
)
def test_ratio_is_held_against_the_goal(goal, ratio, result, text):
    # Speed-ups of the turns are 2, 3 and 6: the median of ratios is not the ratio of the medians.
    found = measurement("a", np.array([[1.0, 2.0], [2.0, 6.0], [3.0, 18.0]]), goal, units=4)
    assert (found.ours_s, found.baseline_s) == (0.5, 1.5)
    assert found.ratio == pytest.approx(ratio)
    assert (found.result, str(goal)) == (result, text)


def one(name: str, ratio: float) -> Measurement:
    return Measurement(name=name, ours_s=1e-5, baseline_s=1e-5 * ratio, ratio=ratio, goal=Goal(2.0))


def test_table_is_aligned():
    first, second, third = table([one("a longer name", 3.0), ("b", "no SAPIEN")]).splitlines()
    assert first.split() == ["measurement", "ours", "baseline", "ratio", "goal", "result"]
    assert second.split() == ["a", "longer", "name", "10", "µs", "30", "µs", "3.00", "≥", "2.00", "reached"]
    assert third.endswith("not measured: no SAPIEN")
    assert first.index("result") == second.index("reached") == third.index("not measured")


@dataclass(frozen=True, kw_only=True, slots=True)
class Toy(Program):
    """A program of this test.

    Attributes:
        ratio: What it finds.
    """

    ratio: float = 3.0

    @part("fast")
    def measured(self):
        return one("fast", self.ratio)

    @part("absent", MissingExtraError("pip install it"))
    @part("broken", SimulatorError("not the same physics"))
    def fail(self, error):
        raise error


def test_help_has_the_keys_of_every_program(capsys):
    with pytest.raises(SystemExit):
        program("toy", Toy, ["--help"])
    said = capsys.readouterr().out
    assert said.startswith("roboverse speed toy key=value")
    assert said.index("    ratio: What") < said.index("    parts: What") < said.index("    out: JSON")


@dataclass(frozen=True, kw_only=True, slots=True)
class SizedToy(DeviceProgram):
    """A program of this test."""

    envs: int = scaled(gpu=8, cpu=2)
    turns: int = scaled(gpu=5, cpu=3)

    @part("one", "one turn")
    @part("more", text="{} turns")
    def measured(self, text):
        return text.format(self.turns)

    @part_each("cup", "box")
    def named(self, name):
        return f"{self.envs} {name}"


def test_sizes_that_are_not_given_suit_the_device(monkeypatch):
    sized = SizedToy(device="cpu", turns=7).sized()
    assert (sized.envs, sized.turns, sized.device, sized.on_gpu) == (2, 7, "cpu", False)
    monkeypatch.setattr("roboverse_learn.training.device.resolve_device", lambda device: device)
    second = SizedToy(device="cuda:1").sized()
    assert (second.envs, second.device, second.on_gpu) == (8, "cuda:1", True)


def test_a_program_compares_as_often_as_its_turns_say():
    calls = []
    found = SizedToy(device="cpu", turns=2).compare("a", lambda: calls.append("ours"), lambda: None)
    assert (calls, found.goal) == (["ours"] * 3, Goal())  # one turn more warms up


def test_parts_are_measured_with_what_they_are_given_in_the_order_of_the_class():
    found = {name: measure() for name, measure in SizedToy(device="cpu").measurements().items()}
    assert list(found.items()) == [
        ("one", "one turn"),
        ("more", "3 turns"),
        ("cup", "2 cup"),
        ("box", "2 box"),
    ]


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["parts=[fast]"], 0),
        (["parts=[fast]", "ratio=1.5"], 1),
        (["parts=[fast,absent]"], 0),
        (["parts=[absent]"], 1),
        ([], 1),
    ],
)
def test_exit_code(words, code, capsys):
    assert program("toy", Toy, words) == code
    assert ("not measured: not the same physics" in capsys.readouterr().out) == (not words)


def test_measurements_are_written(tmp_path):
    out = tmp_path / "not yet there" / "toy.json"
    assert program("toy", Toy, ["parts=[fast,absent]", f"out={out}"]) == 0
    fast, absent = json.loads(out.read_text())["rows"]
    assert (fast["ratio"], fast["goal"]["limit"], fast["result"]) == (3.0, 2.0, "reached")
    assert absent == {"name": "absent", "not_measured": "pip install it"}


def test_an_interrupted_program_keeps_what_it_measured(tmp_path, capsys):
    class Interrupted(Toy):
        def measurements(self):
            def stop():
                raise KeyboardInterrupt

            return {"fast": lambda: one("fast", 3.0), "slow": stop}

    out = tmp_path / "toy.json"
    with contextlib.suppress(KeyboardInterrupt):
        program("toy", Interrupted, [f"out={out}"])
    assert [row["name"] for row in json.loads(out.read_text())["rows"]] == ["fast"]
    assert "fast" in capsys.readouterr().err


def test_unknown_part_suggests_nearest(capsys):
    assert program("toy", Toy, ["parts=[fats]"]) == 2
    assert "Unknown part of speed toy 'fats'. Did you mean 'fast'?" in capsys.readouterr().err

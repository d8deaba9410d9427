"""Where the time of a step goes: of one world on a CPU it only runs."""

import json

import pytest

from roboverse_learn.speed import BENCHMARKS, physics
from roboverse_learn.speed.physics import VARIANTS, Loop, PhysicsBenchmark

GIVEN = PhysicsBenchmark(device="cpu", worlds=1)


def test_it_is_registered():
    assert BENCHMARKS.entry("physics").target == "roboverse_learn.speed.physics"


def test_a_variant_changes_the_model_that_is_stepped():
    loop = Loop(GIVEN, VARIANTS["no contacts"], 1)
    loop.run(1)
    assert loop.solver()["rows, largest"] == 0.0
    loop = Loop(GIVEN, VARIANTS["10 longer steps"], 1)
    assert Loop(GIVEN, VARIANTS["looks at all links"], 1).model.nexclude == 0 < loop.model.nexclude
    assert loop.decimation == 10 and loop.handler.physics_model.opt.timestep == pytest.approx(0.005)


def test_a_robot_that_ignores_itself_still_touches_the_rest():
    loop = Loop(GIVEN, VARIANTS["robot does not touch itself"], 1)
    model = loop.handler.physics_model
    link, hand, cube = (
        model.geom(name) for name in ("franka/link2_collision", "franka/gripper/hand_collision", "cube")
    )

    def touch(a, b):
        return bool(a.contype[0] & b.conaffinity[0] or b.contype[0] & a.conaffinity[0])

    assert not touch(link, hand) and touch(link, cube) and touch(cube, hand)


def test_a_mistyped_word_is_one_line_that_says_what_was_meant(capsys):
    assert physics.main(["wrlds=2"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert "wrlds" in error and "Did you mean 'worlds'?" in error


def test_what_is_measured_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(physics, "VARIANTS", {"as it is": VARIANTS["as it is"]})
    out = tmp_path / "physics.json"
    assert physics.main(["device=cpu", "worlds=1", "turns=1", "warm_steps=1", f"out={out}"]) == 0
    row = json.loads(out.read_text(encoding="utf-8"))["variants"]["as it is"]
    assert row["env_steps_per_s"] == pytest.approx(1e3 / row["ms"])

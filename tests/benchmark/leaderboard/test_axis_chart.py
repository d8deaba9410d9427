"""Success by what varies alone: which policies and axes are drawn, where, and where the images are named."""

import pytest

from benchmark.leaderboard import build as leaderboard
from benchmark.leaderboard.axis_chart import axis_bars, axis_chart, groups_of
from benchmark.protocol import Protocol

AXES = ("robot", "sensor", "layout", "environment", "camera", "lighting")


def cell(only=None, rate=0.5, split="test", level=None, episodes=100):
    ends = {"ci_low": rate - 0.1, "ci_high": rate + 0.1}
    return {"level": level, "only": only, "split": split, "success_rate": rate, "episodes": episodes, **ends}


def row(*cells, entry="act", kind="entry", **changes):
    values = {"entry": entry, "kind": kind, "policy": "act", "label": "act", "cells": list(cells)}
    trained = {"transferred_from": None, "train_level": 0, "train_only": None}
    return values | trained | changes


def bars(*rows):
    return axis_bars({"rows": rows}, lambda each: each["label"])


def test_a_policy_without_an_axis_has_no_bars():
    assert bars(row(cell(level=0), cell(level=3))) == []
    assert axis_chart([]) is None


def test_level_0_is_shown_beside_the_axes_and_no_other_level():
    (only,) = bars(row(cell(level=0), cell(level=3), cell("camera"), cell("camera", split="train")))
    assert set(only["cells"]) == {"level 0", "camera"}
    assert only["cells"]["camera"]["split"] == "test"


def test_levels_and_axes_of_one_entry_may_come_from_two_evaluations():
    """Those that were trained elsewhere are another method, and say so."""
    found = bars(
        row(cell(level=0)),
        row(cell("camera")),
        row(cell("camera"), train_level=3),
        row(cell("robot"), entry="b"),
    )
    assert [(each["label"], set(each["cells"])) for each in found] == [
        ("act", {"level 0", "camera"}),
        ("act, trained at level 3", {"camera"}),
        ("act", {"robot"}),
    ]


def test_studies_have_bars_of_their_own():
    rows = {"rows": [row(cell("camera"), kind="study", label="study"), row(cell("camera"))]}
    for studies, labels in ((True, ["study"]), (False, ["act"])):
        found = axis_bars(rows, lambda each: each["label"], studies=studies)
        assert [each["label"] for each in found] == labels


def test_groups_are_ordered_and_others_come_last():
    found = bars(
        row(cell(level=0), *[cell(only) for only in ("fog", "lighting", "robot", "camera+lighting")])
    )
    assert groups_of(found) == ["level 0", "robot", "lighting", "camera+lighting", "fog"]


def test_nine_policies_become_eight_those_with_most_axes():
    rows = [row(cell("camera"), entry=str(i), label=str(i)) for i in range(8)]
    many = row(cell("camera"), cell("robot"), entry="many", label="many")
    assert [each["label"] for each in bars(*rows, many)] == [*"0123456", "many"]


def test_coordinates_by_hand():
    """Two groups of one policy: 668 units wide in all, a bar fills 78 % of 334, 208 units are 100 %."""
    chart = axis_chart(bars(row(cell(level=0, rate=1.0), cell("robot", rate=0.25))))
    assert chart is not None
    (series,) = chart["series"]
    first, second = series["bars"]
    assert [group["x"] for group in chart["groups"]] == [44 + 167, 44 + 501]
    assert (first["y"], second["y"], chart["bottom"]) == (14, 14 + 0.75 * 208, 222)
    assert first["x"] == pytest.approx(44 + 167 - 0.39 * 334, abs=0.06)
    assert (first["middle"], second["middle"]) == (44 + 167, 44 + 501)
    assert (second["high"], second["low"]) == (pytest.approx(14 + 0.65 * 208, abs=0.06), pytest.approx(190.8))


@pytest.mark.slow
def test_the_board_shows_axes_where_there_are_results_of_them(publish, tmp_path):
    publish(protocol=Protocol(levels=(0,), only=AXES, episodes=8))
    publish(policy="diffusion", protocol=Protocol(levels=(0,), only=AXES[:3], episodes=8))
    publish(task="StackCube", protocol=Protocol(levels=(0,), episodes=8))
    written = leaderboard.write(tmp_path)
    images = sorted(path.name for path in (tmp_path / "plots").glob("*-axes.png"))
    assert images == ["v2-pickcube-mujoco-warp-axes.png"]
    page, table = (written[kind].read_text() for kind in ("html", "markdown"))
    assert page.count("One axis at a time") == 1
    assert page.count("<rect") == 7 + 4 and "layout alone" in table
    assert "plots/v2-pickcube-mujoco-warp-axes.png" in table
    for path in (tmp_path / "v2" / "PickCube").rglob("*.json"):
        path.unlink()
    leaderboard.write(tmp_path)
    assert not list((tmp_path / "plots").glob("*-axes.png")), "an image without results is removed"

"""Plots of success over the levels: at most eight lines, chosen without looking at success."""

import json

import pytest

from benchmark.leaderboard import build as leaderboard
from benchmark.leaderboard.level_chart import chosen_lines, level_chart, line


def cell(level, rate=0.5, split="test", episodes=100, only=None):
    ends = {"ci_low": rate - 0.1, "ci_high": rate + 0.1}
    return {"level": level, "only": only, "split": split, "success_rate": rate, "episodes": episodes, **ends}


def labels(lines):
    return [each["label"] for each in chosen_lines(lines)]


def test_nine_lines_become_eight_whatever_their_success():
    lines = [line(f"line{number}", [cell(0, number / 10), cell(1, number / 10)]) for number in range(9)]
    assert labels(lines) == [f"line{number}" for number in range(8)]
    assert labels(lines[::-1]) == [f"line{number}" for number in range(7, -1, -1)]
    chart = level_chart(lines)
    assert chart is not None
    assert (len(chart["curves"]), chart["left_out"], len({c["color"] for c in chart["curves"]})) == (8, 1, 8)


def test_recipes_come_first_then_levels_then_episodes():
    few = [line(f"a{number}", [cell(0), cell(1)]) for number in range(8)]
    lines = [*few, line("more levels", [cell(0), cell(1), cell(2)]), line("recipe", [cell(0)], first=True)]
    lines.append(line("more episodes", [cell(0, episodes=300), cell(1)]))
    assert labels(lines) == ["a0", "a1", "a2", "a3", "a4", "more levels", "recipe", "more episodes"]


@pytest.mark.parametrize(("number", "splits"), [(4, {"test", "train"}), (5, {"test"})])
def test_the_train_split_counts_as_lines(number, splits):
    both = [cell(level, split=split) for level in (0, 1) for split in ("test", "train")]
    chosen = chosen_lines([line(str(index), both) for index in range(number)])
    assert {each["split"] for line in chosen for each in line["cells"]} == splits


def test_single_points_and_single_channels_are_no_lines():
    assert level_chart([line("one", [cell(0), cell(None, only="camera")]), line("two", [cell(1)])]) is None


def test_coordinates_by_hand():
    chart = level_chart([line("act", [cell(0, 1.0), cell(3, 0.0)])])
    assert chart is not None
    (curve,) = chart["curves"]
    first, last = curve["test"]
    assert (first["x"], last["x"]) == (chart["left"] + 30, chart["right"] - 30)
    assert (first["y"], last["y"]) == (14, chart["bottom"])


@pytest.mark.slow
def test_no_plot_of_a_folder_has_more_than_eight_lines(publish, monkeypatch, tmp_path):
    from benchmark.leaderboard import section_plots

    drawn = []
    monkeypatch.setattr(section_plots, "draw_if_changed", lambda draw, values, *_, **__: drawn.append(values))
    for number in range(10):
        publish(policy=f"policy{number}")
        publish(policy=f"study{number}", recipe="")
    page = leaderboard.write(tmp_path)
    assert [len(values) for values in drawn] == [8, 8]
    assert page["html"].read_text().count('<polyline class="test"') == 8
    assert page["studies html"].read_text().count('<polyline class="test"') == 8
    assert "2 more in the table" in page["html"].read_text()
    assert len(json.loads(page["json"].read_text())["sections"][0]["rows"]) == 20

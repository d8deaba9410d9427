"""Success over the number of demonstrations: which runs make a line, and what the plot says."""

import pytest

from benchmark.leaderboard import build as leaderboard
from benchmark.leaderboard.demonstrations_chart import demonstrations_chart, plot_demonstrations
from benchmark.leaderboard.html import render_studies_html, render_studies_markdown
from benchmark.protocol import Protocol
from benchmark.records import Checkpoint

TEN = Protocol(episodes=10)


def lines(tmp_path):
    (section,) = leaderboard.build(tmp_path)["sections"]
    return section["by_demonstrations"]


def config(preset="", **demonstrations):
    train = {"steps": 2000, "time_limit_s": None}
    return {"preset": preset, "policy": {"chunk_size": 20}, "train": train, **demonstrations}


def study(publish, run, number, rate=0.5, source="expert", **more):
    rates = (rate, 0.0, 0.0, 0.0)
    values = {"config": config(source=source), "protocol": TEN, "recipe": ""} | more
    publish(run=run, demonstrations=number, rates=rates, **values)


def test_expert_and_generated_demonstrations_are_two_lines(publish, tmp_path):
    study(publish, "few", 50, 0.0)
    study(publish, "many", 1000, 1.0)
    study(publish, "made-200", 200, 1.0, "augment")
    study(publish, "made-1000", 1000, 0.0, "augment")
    assert {
        line["label"]: [(point["demonstrations"], point["success_rate"]) for point in line["points"]]
        for line in lines(tmp_path)
    } == {"act": [(50, 0.0), (1000, 1.0)], "act, source=augment": [(200, 1.0), (1000, 0.0)]}


def test_a_single_number_is_no_line(publish, tmp_path):
    study(publish, "few", 50)
    study(publish, "made", 200, source="augment")
    assert lines(tmp_path) == []


@pytest.mark.parametrize(
    "change", [{"checkpoint": Checkpoint(step=9000, hash="ab" * 32)}, {"train_level": 3}, {"image_size": 64}]
)
def test_a_line_changes_nothing_but_the_number(publish, tmp_path, change):
    study(publish, "few", 50)
    study(publish, "many", 1000, **change)
    assert lines(tmp_path) == []


def test_the_tested_level_is_that_of_the_training(publish, tmp_path):
    for number in (50, 200):
        publish(run=str(number), demonstrations=number, train_level=3, rates=(0.0, 0.0, 0.0, 1.0))
    (line,) = lines(tmp_path)
    assert line["level"] == 3
    assert [point["success_rate"] for point in line["points"]] == [1.0, 1.0]


def test_of_two_runs_of_one_number_the_one_with_more_episodes_counts(publish, tmp_path):
    study(publish, "few", 50)
    study(publish, "short", 200, 1.0)
    study(publish, "long", 200, 0.0, protocol=Protocol(episodes=20))
    (line,) = lines(tmp_path)
    assert line["points"][1]["success_rate"] == 0.0
    assert line["points"][1]["episodes"] == 20


def test_a_given_dataset_is_named_by_its_folder_alone(publish, tmp_path):
    for number in (50, 200):
        study(publish, f"given-{number}", number, config=config(dataset="datasets/PickCube/corrections"))
    study(publish, "own", 50)
    assert {row["label"] for row in leaderboard.build(tmp_path)["sections"][0]["rows"]} >= {
        "act, dataset=corrections, 50 demonstrations"
    }


def test_generated_demonstrations_make_no_entry_of_the_board(publish, tmp_path):
    for task in ("PickCube", "StackCube"):
        study(publish, "made", 200, task=task, config=config("gpu", source="augment"))
        study(publish, "own", 200, task=task, config=config("gpu"))
    kinds = {
        (row["runs"][0]["run"], row["kind"])
        for section in leaderboard.build(tmp_path)["sections"]
        for row in section["rows"]
    }
    assert kinds == {("made", "study"), ("own", "entry")}


def test_the_page_of_studies_shows_the_plot(publish, tmp_path):
    study(publish, "few", 50)
    study(publish, "many", 1000)
    board = leaderboard.build(tmp_path)
    assert "-studies-demos.png" in render_studies_markdown(board)
    assert "success by number of demonstrations" in render_studies_html(board)


def test_the_chart_spreads_the_numbers_by_their_logarithm():
    points = [
        {"demonstrations": number, "success_rate": 0.5, "ci_low": 0.25, "ci_high": 1.0, "episodes": 10}
        for number in (10, 100, 1000)
    ]
    chart = demonstrations_chart([{"label": "act", "level": 0, "points": points}])
    assert chart is not None
    first, middle, last = (step["x"] for step in chart["steps"])
    assert middle - first == pytest.approx(last - middle, abs=0.2)
    assert chart["lines"][0]["band"][0][1] < chart["lines"][0]["line"][0][1], "above is smaller in an image"
    assert demonstrations_chart([]) is None


def test_the_plot_is_a_file(tmp_path):
    points = [
        {"demonstrations": number, "success_rate": 0.5, "ci_low": 0.4, "ci_high": 0.6, "episodes": 10}
        for number in (50, 200)
    ]
    plot_demonstrations([{"label": "act", "level": 0, "points": points}], tmp_path / "plot.png")
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")

"""Learning curves: on disk, over seeds, on the page and in an image."""

import json

import numpy as np
import pytest

from benchmark.leaderboard import build as leaderboard
from benchmark.leaderboard import plots
from benchmark.leaderboard.curve_chart import curve_charts, thousands
from benchmark.leaderboard.plots import plot_learning
from benchmark.learning_curves import (
    COLUMNS,
    curve_path,
    over_seeds,
    published,
    published_times,
    read_curve,
    write_curve,
)
from benchmark.results import result_path, write_result
from envs.core.errors import ResultError


def rows(offset=0.0, steps=(100, 200, 300)):
    return [
        {
            "step": step,
            "elapsed_s": step / 50,
            "episode_return": step / 10 + offset,
            "success_rate": step / 400,
        }
        for step in steps
    ]


def curve(offset=0.0, steps=(100, 200, 300)):
    return np.array([[row[name] for name in COLUMNS] for row in rows(offset, steps)])


def test_a_curve_is_read_as_it_was_written(tmp_path):
    result = tmp_path / "run.json"
    assert read_curve(result) is None
    path = write_curve(result, [{"step": 50, "loss": 1.0}, *rows()])  # no episode had ended at first
    assert path == curve_path(result) == tmp_path / "run" / "curve.csv"
    np.testing.assert_allclose(read_curve(result), curve())
    assert path.read_text().startswith("step,elapsed_s,episode_return,success_rate\n100,2,10,0.25\n")


def test_nothing_is_written_of_a_run_without_episodes(tmp_path):
    assert write_curve(tmp_path / "run.json", [{"step": 1, "loss": 2.0}]) is None
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("step,loss\n1,2\n", "its head is step,loss"),
        ("", "not enough values"),
        (",".join(COLUMNS) + "\n1,2,3,x\n", "could not convert string to float: 'x'"),
        (",".join(COLUMNS) + "\n2,1,0,0\n2,2,0,0\n", "its steps do not increase"),
        (",".join(COLUMNS) + "\n", "its head is"),
        (",".join(COLUMNS) + "\n1,2\n3,4\n", "its rows have 2 numbers"),
    ],
)
def test_what_is_no_curve_is_refused(text, reason, tmp_path):
    path = curve_path(tmp_path / "run.json")
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(
        ResultError, match=rf"curve.csv' is no learning curve \({reason}.*Evaluate the run again"
    ):
        read_curve(tmp_path / "run.json")


def test_one_run_has_no_interval():
    found = over_seeds([curve()], num_points=5)
    assert found["steps"] == [100, 150, 200, 250, 300]
    assert found["seconds"] == [2.0, 3.0, 4.0, 5.0, 6.0]
    assert found["episode_return"] == {"mid": [10.0, 15.0, 20.0, 25.0, 30.0], "low": None, "high": None}


def test_runs_are_compared_at_steps_that_all_of_them_have():
    found = over_seeds([curve(steps=(100, 300)), curve(steps=(200, 400))], num_points=2)
    assert found["steps"] == [200, 300]
    with pytest.raises(ValueError, match=r"no steps in common: the latest begins at 300.0, one ends at 200"):
        over_seeds([curve(steps=(100, 200)), curve(steps=(300, 400))])
    with pytest.raises(ValueError, match="at least one run"):
        over_seeds([])


def test_the_middle_half_counts_and_its_interval_holds_it():
    runs = [curve(offset) for offset in (0.0, 1.0, 3.0, 1000.0)]  # one of four at either end is cut off
    found = over_seeds(runs, num_points=2)["episode_return"]
    np.testing.assert_allclose(found["mid"], [12.0, 32.0])
    assert all(
        low < mid < high for low, mid, high in zip(*(found[k] for k in ("low", "mid", "high")), strict=True)
    )
    assert over_seeds(runs, num_points=2)["episode_return"] == found  # the same seed, the same interval


def test_equal_runs_leave_no_doubt():
    found = over_seeds([curve()] * 3, num_points=3)["success_rate"]
    assert found["low"] == found["mid"] == found["high"] == [0.25, 0.5, 0.75]


def test_three_tasks_have_published_curves():
    assert {row["method"]: row["episode_return"] for row in published("humanoid/run")} == {
        "TD-MPC2": 791.7,
        "SimbaV2": 416.0,
    }
    assert [row["steps"] for row in published("humanoid/walk")] == [2_000_000, 1_000_000]
    assert published("PickCube") == []


def test_published_times_name_their_robot():
    found = [published_times(f"humanoid/{task}") for task in ("stand", "walk", "run")]
    assert [[(t["reaches"], t["minutes"], t["robot"]) for t in times] for times in found] == [
        [(800, 49, "H1 with hands")], [(700, 38, "H1 with hands")], [(700, 61, "H1 with hands")]
    ]  # fmt: skip
    assert published_times("PickCube") == []


@pytest.mark.parametrize(("steps", "text"), [(12, "12"), (4000, "4k"), (2_500_000, "2.5M")])
def test_steps_are_short(steps, text):
    assert thousands(steps) == text


def band(offsets=(0.0,), label="ppo", row=0):
    seeds = list(range(len(offsets)))
    return {"label": label, "row": row, "seeds": seeds} | over_seeds([curve(o) for o in offsets])


def test_charts_stay_within_their_frame_and_mark_what_is_published():
    assert curve_charts("PickCube", []) == []
    returns, success = curve_charts("humanoid/stand", [band((0.0, 5.0), row=1)])
    (line,) = returns["lines"]
    assert (line["label"], line["detail"], line["color"]) == ("ppo", "2 seeds, 6 s", plots.COLORS[0])
    assert [other["method"] for other in returns["others"]] == ["TD-MPC2", "SimbaV2"] and not success[
        "others"
    ]
    for chart in (returns, success):
        for x, y in chart["lines"][0]["line"] + chart["lines"][0]["band"]:
            assert chart["left"] <= x <= chart["right"] and 0 <= y <= chart["bottom"]
    assert returns["steps"][-1]["text"] == "2M" and success["steps"][-1]["text"] == "300"


def test_curves_have_different_colours_and_are_eight_at_most(tmp_path):
    curves = [band(label=str(index), row=index) for index in range(9)]
    returns, _ = curve_charts("PickCube", curves[:8])
    assert len({line["color"] for line in returns["lines"]}) == 8
    for draw in (lambda: curve_charts("PickCube", curves), lambda: plot_learning(curves, tmp_path / "a.png")):
        with pytest.raises(ValueError, match="at most 8 lines, given 9"):
            draw()


def test_plot_is_written(tmp_path):
    plot_learning(
        [band(), band((1.0, 2.0), "sac", 1)], tmp_path / "a.png", "humanoid/run", published("humanoid/run")
    )
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_plot_explains_falling_returns_where_success_ends_an_episode(monkeypatch, tmp_path):
    figures = []
    monkeypatch.setattr(plots, "save_figure", lambda figure, *_: figures.append(figure))
    for ends in (True, False):
        plot_learning([band()], tmp_path / "a.png", ends_when_solved=ends)
        titles = [chart["title"] for chart in curve_charts("PickCube", [band()], ends_when_solved=ends)]
        labels = [axes.get_ylabel() for axes in figures.pop().axes]
        assert [("ends when solved" in text) for text in (*labels, *titles)] == [ends, False] * 2


@pytest.mark.slow
@pytest.mark.parametrize(("steps", "ends"), [(250, True), (60, False), (0, None)])
def test_task_ends_when_solved_if_most_solved_episodes_are_short(steps, ends, make_result, tmp_path):
    solved = {"max_episode_steps": steps} if steps else {"rates": (0.0,) * 4}
    result = make_result(policy="ppo", **solved)  # episodes that are solved take 40 to 119 steps
    path = result_path(tmp_path, result)
    write_result(path, result)
    write_curve(path, rows())
    written = leaderboard.write(tmp_path)
    (section,) = json.loads(written["json"].read_text())["sections"]
    assert section["ends_when_solved"] is ends
    assert ("ends when solved" in written["html"].read_text()) is bool(ends)


@pytest.mark.slow
def test_the_page_shows_the_curves_of_a_section(make_result, tmp_path):
    for seed in range(2):
        result = make_result(policy="ppo", seed=seed, task="humanoid/walk")
        path = result_path(tmp_path, result)
        write_result(path, result)
        write_curve(path, rows(float(seed)))
    written = leaderboard.write(tmp_path)
    (section,) = json.loads(written["json"].read_text())["sections"]
    assert section["curves"][0]["episode_return"]["mid"][0] == 10.5
    page, markdown = written["html"].read_text(), written["markdown"].read_text()
    assert "Reinforcement learning" in page and 'class="band"' in page and "TD-MPC2, 815.8" in page
    assert "ppo by rsl_rl (2 seeds, 6 s)<" in page
    assert f"plots/{section['id']}-learning.png" in markdown
    for text in (page, markdown):
        assert "FastTD3 on one A100 took 38 minutes and 4.48 M steps until tests" in text
        assert "of the H1 with hands returned 700." in text
    assert written[f"learning {section['id']}"].is_file()


@pytest.mark.slow
def test_a_section_without_curves_has_no_chart_of_them(make_result, tmp_path):
    result = make_result()
    write_result(result_path(tmp_path, result), result)
    written = leaderboard.write(tmp_path)
    assert "Reinforcement learning" not in written["html"].read_text()
    assert not any(name.startswith("learning") for name in written)

"""The table over all tasks: its rows and their mean."""

import pytest

from benchmark.leaderboard import build as leaderboard
from benchmark.leaderboard.html import render_studies_html, render_studies_markdown
from benchmark.protocol import Protocol
from benchmark.records import Checkpoint

TEN = Protocol(episodes=10)


def tables(tmp_path):
    return leaderboard.build(tmp_path)["overview"]


def rates(row, train="0"):
    return {level: cell["success_rate"] for level, cell in row["trained"][train].items()}


def test_one_task_needs_no_overview(publish, tmp_path):
    publish()
    publish(policy="diffusion")
    assert tables(tmp_path) == []


def test_rows_are_tasks_and_policies_by_the_level_they_were_trained_at(publish, tmp_path):
    publish(rates=(1.0, 1.0, 0.0, 0.0), protocol=TEN)
    publish(run="l3", train_level=3, rates=(0.0, 0.0, 1.0, 1.0), protocol=TEN)
    publish(task="CloseBox", rates=(1.0, 0.0, 0.0, 0.0), protocol=TEN)
    (table,) = tables(tmp_path)
    assert (table["simulator"], table["renderer"], table["protocol"]) == ("mujoco", "warp", "v2")
    assert (table["train_levels"], table["test_levels"]) == (["0", "3"], ["0", "1", "2", "3"])
    box, cube = table["rows"]
    assert (box["task"], cube["task"], cube["policy"]) == ("CloseBox", "PickCube", "act")
    assert rates(box) == {"0": 1.0, "1": 0.0, "2": 0.0, "3": 0.0}
    assert rates(cube, "3") == {"0": 0.0, "1": 0.0, "2": 1.0, "3": 1.0}
    assert set(cube["trained"]["3"]["3"]) == {"success_rate", "ci_low", "ci_high", "episodes"}
    assert cube["trainings"] == {level: {"demonstrations": 100, "steps": 2000, "seeds": 1} for level in "03"}
    assert "means" not in table, "budgets differ from cell to cell"


@pytest.mark.parametrize(
    ("better", "worse"),
    [
        ({"protocol": TEN}, {"protocol": Protocol(episodes=8), "demonstrations": 900}),
        ({"demonstrations": 200}, {"checkpoint": Checkpoint(step=9000, hash="ab" * 32)}),
        ({"checkpoint": Checkpoint(step=9000, hash="ab" * 32)}, {"created": "2026-05-01T12:00:00Z"}),
        ({}, {"checkpoint": Checkpoint(step=None, hash="ab" * 32), "created": "2026-05-01T12:00:00Z"}),
        ({}, {"recipe": "act_rare", "created": "2026-05-01T12:00:00Z"}),
        ({"created": "2026-05-01T12:00:00Z"}, {}),
    ],
)
def test_overview_shows_the_row_with_most_test_episodes(publish, tmp_path, better, worse):
    publish(run="worse", rates=(1.0,) * 4, **worse)
    publish(run="better", rates=(0.0,) * 4, **better)
    publish(task="CloseBox")
    (table,) = tables(tmp_path)
    assert rates(table["rows"][1])["0"] == 0.0


def test_a_checkpoint_that_does_not_say_its_step_is_shown_without(publish, tmp_path):
    unknown = Checkpoint(step=None, hash="ab" * 32)
    publish(checkpoint=unknown)
    publish(task="CloseBox", checkpoint=unknown)
    publish(task="CloseBox", policy="diffusion", seed=1, checkpoint=unknown)
    publish(task="CloseBox", policy="diffusion", seed=2)
    board = leaderboard.build(tmp_path)
    (table,) = board["overview"]
    steps = [row["trainings"]["0"]["steps"] for row in table["rows"]]
    assert steps == [0, 2000, 0]
    html = render_studies_html(board)
    assert "100 demonstrations, 1 seed" in html and "100 demonstrations, 2000 steps, 1 seed" in html
    assert "None" not in render_studies_markdown(board)


@pytest.mark.parametrize(
    "change",
    [
        {"demonstrations": None, "dataset_hash": None},  # reinforcement learning
        {"train_level": None, "train_only": "camera"},
        {"task_kwargs": {"success": "lift"}},
        {"scenario": {"cameras": {"front": {"fovy_deg": 30.0}}}},
        {"config": {"policy": {}, "run": {"simulator": "sapien", "renderer": "sapien"}}},
        {"config": {"policy": {}, "source": "augment"}},
    ],
)
def test_results_that_are_not_comparable_are_left_out(publish, tmp_path, change):
    publish(task="CloseBox")
    publish(task="StackCube")
    publish(policy="diffusion", **change)
    (table,) = tables(tmp_path)
    assert [(row["task"], row["policy"]) for row in table["rows"]] == [
        ("CloseBox", "act"),
        ("StackCube", "act"),
    ]


def test_the_longest_table_comes_first(publish, tmp_path):
    for task in ("CloseBox", "PickCube"):
        publish(task=task)
        publish(run="elsewhere", task=task, simulator="sapien", renderer="sapien")
        publish(task=task, policy="diffusion", simulator="sapien", renderer="sapien")
    assert [table["simulator"] for table in tables(tmp_path)] == ["sapien", "mujoco"]


def test_the_page_of_studies_shows_the_table(publish, tmp_path):
    publish(rates=(1.0, 1.0, 0.0, 0.0), protocol=TEN)
    publish(task="CloseBox", rates=(1.0, 0.0, 0.0, 0.0), protocol=TEN)
    board = leaderboard.build(tmp_path)
    assert "| PickCube | act | **100** · 100 · 0 · 0 |\n" in render_studies_markdown(board)
    html = render_studies_html(board)
    assert 'title="trained at level 0, tested at level 1: 72–100 % in 10 episodes; 100 demonstrations' in html
    assert "2000 steps, 1 seed" in html

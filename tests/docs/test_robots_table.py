"""The table of robots on the page is that of the results."""

from pathlib import Path

from envs.experts.robots import as_text, read_table

ROOT = Path(__file__).parents[2]
CELLS = read_table(ROOT / "results" / "robots.json")


def test_the_page_shows_the_measured_table():
    assert as_text(CELLS) in (ROOT / "docs/howto/add_a_robot.md").read_text(encoding="utf-8")


FEWER = {("jaco_three_finger", "NutAssembly"): 0.8}
"""Cells whose share of successes is lower; the page says why."""


def test_experts_succeed_on_every_robot_in_nine_of_ten_episodes():
    counted = [cell for cell in CELLS if "refused" not in cell]
    assert len(counted) >= 103
    for cell in counted:
        least = FEWER.get((cell["robot"], cell["task"]), 0.9)
        assert cell["num_successes"] >= least * cell["num_episodes"], cell


def test_a_robot_that_cannot_do_a_task_says_what_it_lacks():
    assert all(" mm " in cell["refused"] for cell in CELLS if "refused" in cell)

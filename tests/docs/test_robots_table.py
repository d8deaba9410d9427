"""The table of robots on the page is that of the results."""

from pathlib import Path

from envs.experts.robots import as_text, read_table

ROOT = Path(__file__).parents[2]
CELLS = read_table(ROOT / "results" / "robots.json")


def test_the_page_shows_the_measured_table():
    assert as_text(CELLS) in (ROOT / "docs/howto/add_a_robot.md").read_text(encoding="utf-8")


def test_experts_succeed_on_every_robot_in_nine_of_ten_episodes():
    assert len(CELLS) >= 24
    assert all(c["num_successes"] >= 0.9 * c["num_episodes"] for c in CELLS)

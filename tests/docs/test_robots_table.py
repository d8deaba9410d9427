"""The table of robots on the page is that of the results, and every robot does its tasks."""

from pathlib import Path

from envs.experts.robots import as_text, read_table

ROOT = Path(__file__).parents[2]
CELLS = read_table(ROOT / "results" / "robots.json")


def test_the_page_shows_the_measured_table():
    assert as_text(CELLS) in (ROOT / "docs/howto/add_a_robot.md").read_text(encoding="utf-8")


def test_experts_succeed_on_every_robot():
    assert len(CELLS) >= 24
    for cell in CELLS:
        assert cell["num_successes"] >= 0.9 * cell["num_episodes"], (cell["robot"], cell["task"])

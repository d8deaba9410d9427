"""The table of robots on the page is that of the results, and says where a robot falls short."""

from pathlib import Path

from envs.experts.robots import as_text, read_table

ROOT = Path(__file__).parents[2]
CELLS = read_table(ROOT / "results" / "robots.json")


def test_the_page_shows_the_measured_table():
    assert as_text(CELLS) in (ROOT / "docs/howto/add_a_robot.md").read_text(encoding="utf-8")


BELOW = {("jaco", task) for task in ("NutAssembly", "NutAssemblySquare", "PickCube")}
"""Robot and task of fewer than nine successes in ten episodes; the page says so."""


def test_experts_succeed_on_every_robot_but_those_that_the_page_names():
    assert len(CELLS) >= 24
    low = {(c["robot"], c["task"]) for c in CELLS if c["num_successes"] < 0.9 * c["num_episodes"]}
    assert low == BELOW

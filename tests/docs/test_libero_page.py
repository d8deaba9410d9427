"""The page of LIBERO's tasks."""

from docs.generate import libero_page
from envs.experts.counts import read_rows
from envs.tasks.libero.catalogue import entries


def test_the_page_is_what_the_results_say():
    expected = libero_page.page(read_rows(libero_page.RESULTS))
    assert libero_page.PAGE.read_text(encoding="utf-8") == expected, "python -m docs.generate.libero_page"


def test_each_task_is_named_with_its_rate():
    name = "libero/goal/turn_on_the_stove"
    text = libero_page.page(
        {name: {"expert": 0.95, "episodes": 20}, "PickCube": {"expert": 1.0, "episodes": 5}}
    )
    assert f"| {name} | turn on the stove | 95 % | 20 |" in text
    assert "1 of 130 tasks are counted; the expert reaches 80 % in 1 of them." in text
    assert all(f"| {other} |" in text for other in entries())

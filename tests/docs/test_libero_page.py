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


def test_libero_pro_is_summed_up_by_suite():
    rows = {
        "libero_pro/goal_swap/turn_on_the_stove": {"expert": 1.0, "episodes": 20, "git_sha": "a" * 40},
        "libero_pro/goal_swap/put_the_bowl_on_the_plate": {"expert": 0.6, "episodes": 5, "git_sha": "b" * 40},
    }
    text = libero_page.page(rows)
    assert "| libero_pro/goal_swap | 2 of 10 | 1 | 80 % | 5 to 20 |" in text
    assert "The expert at aaaaaaaa and bbbbbbbb, " in text
    assert "| libero_pro/10_task | 0 of 10 | 0 |  |  |" in text
    assert "### LIBERO-PRO" not in libero_page.page({}), "nothing is counted"

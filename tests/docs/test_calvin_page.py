"""The page of CALVIN's tasks and chains."""

from benchmark.chain_results import read_results
from docs.generate import calvin_page
from envs.experts.counts import read_rows
from envs.tasks.calvin.catalogue import task_facts


def test_the_page_is_what_the_results_say():
    expected = calvin_page.page(
        read_rows(calvin_page.RESULTS), read_results(calvin_page.CHAINS).get("expert", {})
    )
    assert calvin_page.PAGE.read_text(encoding="utf-8") == expected, "python -m docs.generate.calvin_page"


def test_each_task_is_named_with_its_rate_and_the_chains_with_their_length():
    rows = {
        "calvin/D/open_drawer": {"expert": 0.75, "episodes": 20},
        "calvin/A/open_drawer": {"expert": 1.0, "episodes": 10},
    }
    text = calvin_page.page(rows, {0: 5, 7: 2})
    assert "| calvin/D/open_drawer | pull the handle to open the drawer | 75 % | 20 |" in text
    assert "1 of 34 tasks are counted in scene D; the expert reaches 80 % in 0 of them." in text
    assert "in 2 of the chains: average length **3.50** of 5." in text
    assert "| chains | 100.0 % | 100.0 % | 50.0 % | 50.0 % | 50.0 % |" in text
    assert all(f"| calvin/D/{task} |" in text for task in task_facts())
    assert "it reaches 80 % in 1 of 1 in A:" in text
    assert "| open_drawer | 100 % |" in text and "| close_drawer | not counted |" in text

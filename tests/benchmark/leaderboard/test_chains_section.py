"""CALVIN's chains on the board: rows, their order, and what the pages say."""

import json

import pytest

from benchmark.chain_results import FILE
from benchmark.leaderboard import build as leaderboard
from benchmark.leaderboard import html
from benchmark.leaderboard.chains_section import chain_rows
from benchmark.statistics import wilson
from envs.core.errors import ConfigError


def run(*counts, sha="abc", command="roboverse evaluate chains=4"):
    solved = {str(index): count for index, count in enumerate(counts)}
    return {"command": command, "git_sha": sha, "seed": 0, "solved": solved}


def written(folder, policies):
    (folder / FILE).write_text(json.dumps(policies))
    return folder


def test_a_row_by_hand(tmp_path):
    (row,) = chain_rows(written(tmp_path, {"my run 01234567 89abcdef": [run(5, 0, 2, 5)]}))
    assert (row["policy"], row["is_baseline"], row["version"]) == ("my run", False, "")
    assert (row["chains"], row["average_length"]) == (4, 3.0)
    assert 0.0 <= row["ci_low"] < 3.0 < row["ci_high"] <= 5.0
    assert [rate["success_rate"] for rate in row["rates"]] == [0.75, 0.75, 0.5, 0.5, 0.5]
    assert (row["rates"][0]["ci_low"], row["rates"][0]["ci_high"]) == wilson(3, 4)
    assert row["git_sha"] == "abc" and row["commands"] == ["roboverse evaluate chains=4"]


def test_the_interval_is_a_point_where_all_chains_end_alike(tmp_path):
    (row,) = chain_rows(written(tmp_path, {"expert": [run(5, 5, 5)]}))
    assert (row["average_length"], row["ci_low"], row["ci_high"]) == (5.0, 5.0, 5.0)


def test_rows_are_in_the_order_of_their_average_length_and_baselines_are_named(tmp_path):
    policies = {
        "weak 0 1": [run(1, 0)],
        "expert": [run(5, 5)],
        "expert 2f": [run(4, 4)],  # in another scene
        "good 0 1": [run(5, 4)],
        "none": [],
        "nothing 0 1": [run()],
    }
    rows = chain_rows(written(tmp_path, policies))
    named = [("expert", True, ""), ("good", False, ""), ("expert", True, "2f"), ("weak", False, "")]
    assert [(row["policy"], row["is_baseline"], row["version"]) for row in rows] == named


def test_two_networks_of_one_name_are_told_apart(tmp_path):
    rows = chain_rows(written(tmp_path, {"mine 0 1": [run(5)], "mine 2 1": [run(4)]}))
    assert [(row["policy"], row["version"]) for row in rows] == [("mine", "0 1"), ("mine", "2 1")]


def test_a_row_has_the_chains_of_one_commit_in_all_its_parts(tmp_path):
    rest = {"command": "rest", "git_sha": "abc", "seed": 0, "solved": {"2": 3, "10": 0}}
    (row,) = chain_rows(written(tmp_path, {"mine 0 1": [run(5, 5), rest, run(1, 1, sha="def")]}))
    assert row["chains"] == 4 and row["average_length"] == 13 / 4 and row["git_sha"] == "abc"
    assert row["commands"] == ["roboverse evaluate chains=4", "rest"]


def test_a_board_without_chains_is_as_before(publish, tmp_path):
    publish()
    board = leaderboard.build(tmp_path)
    assert "chains" not in board
    assert 'id="chains"' not in html.render_html(board) and "chains" not in html.render_markdown(board)


def test_the_pages_show_chains_also_where_there_is_nothing_else(publish, tmp_path):
    written(tmp_path, {"mine 0 1": [run(5, 0, 2, 5)], "expert": [run(5, sha=None)]})  # not in a checkout
    for alone in (True, False):
        board = leaderboard.build(tmp_path)
        page, table = html.render_html(board), html.render_markdown(board)
        assert 'href="#chains"' in page and "<b>3.00</b>" in page and "4 chains" in page
        assert "No results yet" not in page and "No results yet" not in table
        assert "| **mine** | abc | 4 | **3.00** (" in table and "75 (30–95)" in table
        if alone:
            publish()


def test_a_damaged_file_of_chains_is_an_error_that_names_it(tmp_path):
    (tmp_path / FILE).write_text("{")
    with pytest.raises(ConfigError, match=FILE):
        leaderboard.build(tmp_path)

"""Instruction tests have a page of their own, and change no other table."""

from dataclasses import replace

import pytest

from benchmark.leaderboard import build as leaderboard
from benchmark.leaderboard.labels import difference, difference_interval, points
from benchmark.protocol import Protocol
from benchmark.results import result_path, write_result

PLAIN = Protocol(episodes=4)
TESTED = Protocol(episodes=4, instructions=("new_words", "wrong"))


@pytest.fixture
def tested(make_result, tmp_path):
    """Writes a result whose policy does the task whatever it is asked, save with new words."""
    result = make_result(protocol=TESTED, rates=(1.0, 1.0, 1.0, 1.0))
    records = (replace(r, success=r.instruction_test != "new_words") for r in result.records)
    write_result(result_path(tmp_path, result), replace(result, records=tuple(records)))


@pytest.mark.slow
def test_the_page_is_there_only_with_instruction_tests(tested, publish, tmp_path):
    written = leaderboard.write(tmp_path)
    text, page = (written[f"instructions {kind}"].read_text() for kind in ("markdown", "html"))
    assert "| **100** | **0** (+100, 31 to 100) |" in text
    assert "| **100** | **100** (+0, −49 to 49) |" in text
    assert "wrong instruction" in text and "wrong instruction" in page and "empty instruction" not in page
    assert 'href="instructions.html"' in written["html"].read_text()
    assert "instructions.md" in written["markdown"].read_text()
    publish(protocol=PLAIN)
    again = leaderboard.write(tmp_path)
    assert "instructions html" not in again and not (tmp_path / "instructions.html").exists()
    assert "instructions" not in again["html"].read_text()


@pytest.mark.slow
def test_held_out_wordings_are_compared_with_known_ones(tested, make_result, tmp_path):
    protocol = replace(TESTED, instructions=("known", "new_words", "wrong"))
    result = make_result(protocol=protocol, seed=1, rates=(1.0, 1.0, 1.0, 1.0))
    fails = {("new_words", 9000), ("new_words", 9001)}
    records = (replace(r, success=(r.instruction_test, r.episode) not in fails) for r in result.records)
    write_result(result_path(tmp_path, result), replace(result, records=tuple(records)))
    without, row = leaderboard.build(tmp_path)["instructions"]
    assert without["gaps"] == {} and list(row["gaps"]) == ["new_words"]
    assert (row["gaps"]["new_words"]["known_rate"], row["gaps"]["new_words"]["held_out_rate"]) == (1.0, 0.5)
    written = leaderboard.write(tmp_path)
    text, page = (written[f"instructions {kind}"].read_text() for kind in ("markdown", "html"))
    gap = row["gaps"]["new_words"]
    assert f"| **50** ({points(gap)}) | {points(gap)} |" in text and "| known − new words |" in text
    shown = f"<b>{difference(gap)}</b><small>{difference_interval(gap)}</small></td>"
    assert shown in page and "known − new frame" not in page


def test_other_tables_are_those_without_instruction_tests(make_result, publish, tmp_path):
    publish(protocol=TESTED)
    with_tests = leaderboard.build(tmp_path)
    publish(protocol=PLAIN)
    without = leaderboard.build(tmp_path)
    assert with_tests.pop("instructions") and "instructions" not in without
    assert with_tests == without


def test_a_row_of_the_table(tested, tmp_path):
    (row,) = leaderboard.build(tmp_path)["instructions"]
    assert (row["task"], row["policy"], row["seed"], row["episodes"]) == ("PickCube", "act", 0, 4)
    assert row["right"] == 1.0 and list(row["scores"]) == ["new_words", "wrong"]
    assert row["scores"]["wrong"]["difference"] == 0.0 and row["scores"]["new_words"]["test_rate"] == 0.0


@pytest.mark.slow
def test_runs_of_two_recipes_are_told_apart(make_result, tmp_path):
    for name in ("first_v1", "second_v1"):
        result = make_result(protocol=TESTED, run=name, recipe=name)
        write_result(result_path(tmp_path, result), result)
    written = leaderboard.write(tmp_path)
    for kind in ("markdown", "html"):
        text = written[f"instructions {kind}"].read_text()
        assert " · recipe first_v1" in text and " · recipe second_v1" in text


def test_points_have_a_sign_and_no_negative_zero():
    score = {"difference": -0.004, "ci_low": -0.121, "ci_high": 0.1}
    assert (difference(score), difference_interval(score)) == ("+0", "−12 to 10")
    assert points(score) == "+0, −12 to 10"

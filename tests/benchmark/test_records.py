import json
from dataclasses import replace

import pytest

from benchmark.protocol import Protocol
from benchmark.records import check_complete, summarize
from benchmark.statistics import confidence_sequence, narrow_after, wilson
from envs.core.errors import ResultError

PROTOCOL = Protocol(levels=(0, 3), splits=("test",), episodes=4)


@pytest.fixture
def records(make_records):
    return make_records(PROTOCOL)


def test_a_cell_by_hand(records):
    given = [
        replace(record, success=success, length=length, episode_return=value)
        for record, success, length, value in zip(
            records[:4], (True, False, True, True), (10, 50, 20, 40), (1.0, -2.0, 0.5, 0.5), strict=True
        )
    ]
    (summary,) = summarize(given)
    assert (summary.episodes, summary.successes, summary.success_rate) == (4, 3, 0.75)
    assert (summary.ci_low, summary.ci_high) == wilson(3, 4)
    assert (summary.mean_length, summary.mean_return) == (30.0, 0.0)


def test_cells_keep_what_could_not_be_shown(records):
    assert [summary.not_shown for summary in summarize(records)] == [(), ("metallic",)]


def test_a_record_is_one_line_of_json(records):
    line = json.dumps(records[0].to_json())
    assert json.loads(line)["initial_state_hash"] == records[0].initial_state_hash
    assert json.loads(line)["channels"] == ["task"]


def test_records_of_a_cell_must_agree_on_what_varied(records):
    with pytest.raises(ResultError, match="level 0, test split disagree on which channels varied"):
        summarize([*records[:3], replace(records[3], channels=("task", "camera"))])


def test_a_complete_set_passes(records):
    check_complete(PROTOCOL, records)


def test_cells_of_a_split_share_their_episodes(records):
    with pytest.raises(ResultError, match="cells of the test split are not of the same episodes"):
        check_complete(PROTOCOL, [*records[:-1], replace(records[-1], episode=1)])


def test_cells_that_end_early_have_exactly_the_episodes_of_the_rule(make_records):
    protocol = Protocol(levels=(0, 3), splits=("test",), episodes=40, width=0.4)
    whole = [replace(record, success=record.level == 0) for record in make_records(protocol)]
    first, second = whole[:40], [replace(r, success=index % 2 == 0) for index, r in enumerate(whole[40:])]
    enough = narrow_after([True] * 40, 0.4)
    assert enough is not None and enough < 40
    later = narrow_after([record.success for record in second], 0.4) or 40
    assert later > enough
    ended = [*first[:enough], *second[:later]]
    check_complete(protocol, ended)
    (cell, _) = summarize(ended, stopped_early=True)
    assert (cell.ci_low, cell.ci_high) == confidence_sequence(enough, enough)
    for count, needed in ((enough - 1, 40), (enough + 1, enough)):
        with pytest.raises(ResultError, match=f"protocol needs {needed}, each once"):
            check_complete(protocol, [*first[:count], *second[:later]])
    swapped = [*first[: enough - 1], replace(first[0], episode=99), *second[:later]]
    with pytest.raises(ResultError, match="not of the same episodes"):
        check_complete(protocol, swapped)


def test_an_extra_cell_is_named(records):
    with pytest.raises(ResultError, match=r"missing none, unexpected level 0, train split"):
        check_complete(PROTOCOL, [*records, replace(records[0], split="train")])

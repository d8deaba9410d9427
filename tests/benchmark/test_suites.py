"""The mean of a suite, its interval, and its file."""

import dataclasses
import json

import numpy as np
import pytest

from benchmark.leaderboard.suites_section import MOST_SECTIONS, suite_sections, without_section
from benchmark.protocol import Protocol
from benchmark.statistics import mean_of_few, mean_of_rates, wilson
from benchmark.suites import (
    SuiteResult,
    mean_over_tasks,
    read_suite,
    suite_path,
    summarize_suite,
    write_suite,
)
from envs.core.errors import ResultError

SUITE = SuiteResult(
    suite="two",
    run="random-1",
    policy="random",
    created="2026-01-01T00:00:00Z",
    protocol=Protocol(levels=(0,), splits=("test",), episodes=2),
    tasks=("A", "B"),
    results={"A": "v2/A/random/random-1.json"},
    failed={"B": "its mesh is missing"},
)


def rates(outcomes):
    return [(each.mean(), *wilson(int(each.sum()), len(each))) for each in outcomes]


def test_every_task_weighs_the_same_whatever_its_number_of_episodes():
    outcomes = [np.ones(4, bool), np.zeros(100, bool)]
    assert mean_over_tasks(rates(outcomes))[0] == 0.5


def test_tasks_that_differ_make_the_interval_wide():
    """With 1,000 episodes each the rates are known; which tasks the suite has is not."""
    outcomes = [np.ones(1000, bool), np.zeros(1000, bool)] * 2
    mean, low, high = mean_over_tasks(rates(outcomes))
    assert mean == 0.5 and low == 0.0 and high == 1.0
    within = mean_of_rates(rates(outcomes))
    assert within[2] - within[1] < 0.01, "what episodes alone would say"


def test_tasks_that_all_succeed_are_not_called_certain():
    outcomes = [np.ones(20, bool)] * 10
    mean, low, high = mean_over_tasks(rates(outcomes))
    assert (mean, high) == (1.0, 1.0) and 0.9 < low < 0.97
    assert mean_of_few([1.0] * 10) == (1.0, 1.0), "what the tasks' rates alone would say"


def test_one_task_has_its_own_interval():
    outcomes = [np.array([True, False, True, True])]
    assert mean_over_tasks(rates(outcomes)) == pytest.approx((0.75, *wilson(3, 4)))


def test_a_suites_file_is_read_as_it_was_written(tmp_path):
    path = write_suite(tmp_path, SUITE, {})
    assert path == suite_path(tmp_path, SUITE) == tmp_path / "suites" / "two" / "random" / "random-1.json"
    assert read_suite(path) == SUITE


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text[:-40], "is no result of a suite"),
        (lambda text: text.replace('"tasks"', '"task"'), "it has no 'tasks'"),
        (lambda text: text.replace('"schema_version": 1', '"schema_version": 9'), "schema version 9"),
        (lambda text: text.replace('"A": "v2', '"C": "v2'), "'C' is none of its tasks"),
    ],
)
def test_a_file_that_is_damaged_is_refused_with_its_name(tmp_path, change, said):
    path = write_suite(tmp_path, SUITE, {})
    path.write_text(change(path.read_text()))
    with pytest.raises(ResultError, match=said) as caught:
        read_suite(path)
    assert str(path) in str(caught.value)


def test_the_file_names_why_a_task_has_no_result(tmp_path):
    document = json.loads(write_suite(tmp_path, dataclasses.replace(SUITE), {}).read_text())
    assert document["failed"] == {"B": "its mesh is missing"}


def test_the_file_tells_an_instruction_test_from_level_0(tmp_path, make_result):
    protocol = Protocol(levels=(0,), splits=("test",), episodes=4, instructions=("wrong",))
    results = {"A": make_result(task="A", protocol=protocol)}
    document = json.loads(write_suite(tmp_path, SUITE, results).read_text())
    assert [cell.get("instruction_test") for cell in document["cells"]] == [None, "wrong"]


def test_a_summary_has_the_cells_that_every_task_has(make_result):
    protocol = Protocol(levels=(0, 3), splits=("test",), episodes=4)
    only_level_0 = Protocol(levels=(0,), splits=("test",), episodes=4)
    both = {
        "PickCube": make_result(protocol=protocol, rates=(1.0, 1.0, 1.0, 0.0)),
        "StackCube": make_result(protocol=protocol, task="StackCube", rates=(0.0, 0.0, 0.0, 0.0)),
    }
    level_0, level_3 = summarize_suite(both)
    assert (level_0.cell.level, level_0.success_rate, level_0.successes, level_0.episodes) == (0, 0.5, 4, 8)
    assert (level_3.cell.level, level_3.success_rate, level_3.tasks) == (3, 0.0, 2)
    lacking = both | {"StackCube": make_result(protocol=only_level_0, task="StackCube")}
    assert [each.cell.level for each in summarize_suite(lacking)] == [0]
    assert summarize_suite({}) == ()


def test_results_by_another_benchmarks_protocol_are_in_the_suites_row_alone():
    results = {"A": "v2/A/random/random-1.json"}
    assert without_section([SUITE]) == set()
    assert without_section([dataclasses.replace(SUITE, named_protocol="libero")]) == set(results.values())
    many = dataclasses.replace(SUITE, tasks=("A", *map(str, range(MOST_SECTIONS))))
    assert without_section([many]) == set(results.values())


def test_a_row_names_the_settings_that_the_suites_name_does_not_say(make_result):
    path = SUITE.results["A"]
    usual = make_result(task="A")
    other = make_result(task="A", task_kwargs={"starts": "libero"}, robot="ur5e")
    rows = [suite_sections([SUITE], {path: each})[0]["rows"][0] for each in (usual, other)]
    assert [row["settings"] for row in rows] == ["", "robot=ur5e, starts=libero"]
    by_protocol = dataclasses.replace(SUITE, named_protocol="libero")
    assert suite_sections([by_protocol], {path: other})[0]["rows"][0]["settings"] == ""

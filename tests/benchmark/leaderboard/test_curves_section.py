"""Which trainings share a learning curve, and which do not."""

import json

import pytest

from benchmark.leaderboard import build as leaderboard
from benchmark.leaderboard.curves_section import learning_curves
from benchmark.learning_curves import write_curve
from benchmark.results import result_path, write_result


def logged(*steps):
    return [{"step": s, "elapsed_s": s, "episode_return": s, "success_rate": 0.5} for s in steps]


@pytest.fixture
def trained(make_result, tmp_path):
    """A function that leaves the result and the curve of a training, and returns it as an entry."""

    def make(seed, *steps, policy=None, **train):
        config = {"policy": {"num_updates": 8, **(policy or {})}, "train": {"steps": 10_000, **train}}
        run = f"seed{seed}-{len(list(tmp_path.rglob('*.json')))}"
        result = make_result(policy="ppo", run=run, seed=seed, config=config)
        path = result_path(tmp_path, result)
        write_result(path, result)
        if steps:
            write_curve(path, logged(*steps))
        return path.relative_to(tmp_path).as_posix(), result

    return make


@pytest.mark.slow
def test_curve_over_seeds_ends_with_the_shortest_run(trained, tmp_path):
    rows = [[trained(2, 100, 300, time_limit_s=560.0)], [trained(1, 50, 200, 400, time_limit_s=600.0)]]
    (curve,) = learning_curves(tmp_path, rows)
    assert (curve["label"], curve["row"], curve["seeds"]) == ("ppo", 0, [1, 2])
    assert (curve["steps"][0], curve["steps"][-1]) == (100, 300)
    assert curve["episode_return"]["low"] is not None
    assert [run["run"] for run in curve["runs"]] == ["seed1-1", "seed2-0"]


def test_curves_of_different_settings_name_the_difference(trained, tmp_path):
    rows = [[trained(0, 100, 200, policy={"num_updates": 4})], [trained(1, 100, 200)]]
    curves = learning_curves(tmp_path, rows)
    assert [curve["label"] for curve in curves] == ["ppo, num_updates 4", "ppo, num_updates 8"]
    assert [(curve["row"], curve["seeds"]) for curve in curves] == [(0, [0]), (1, [1])]


def test_a_second_training_of_a_seed_is_no_further_sample(trained, tmp_path):
    rows = [[trained(0, 100, 200), trained(1, 100, 300)], [trained(0, 100, 400)]]
    curves = learning_curves(tmp_path, rows)
    assert [curve["seeds"] for curve in curves] == [[0, 1], [0]]
    assert len({curve["label"] for curve in curves}) == 2


def test_a_run_tested_twice_is_plotted_once(trained, tmp_path):
    rows = [[trained(0, 100, 200)], [trained(0, 100, 200)]]
    assert [curve["row"] for curve in learning_curves(tmp_path, rows)] == [0]


def test_runs_without_common_steps_have_separate_curves(trained, tmp_path):
    rows = [[trained(0, 10, 20), trained(1, 100, 200)], [trained(2)]]
    assert [curve["seeds"] for curve in learning_curves(tmp_path, rows)] == [[0], [1]]


@pytest.mark.slow
def test_rows_of_results_stay_apart_where_curves_do_not(trained, tmp_path):
    trained(1, 100, 400, time_limit_s=600.0)
    trained(2, 100, 300, time_limit_s=560.0)
    (section,) = json.loads(leaderboard.write(tmp_path)["json"].read_text())["sections"]
    assert sorted(row["seeds"] for row in section["rows"]) == [[1], [2]]
    assert [curve["seeds"] for curve in section["curves"]] == [[1, 2]]

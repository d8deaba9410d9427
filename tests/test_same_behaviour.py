"""What .ci/same_behaviour says of two checkouts."""

import importlib.machinery
import importlib.util
import sys
from pathlib import Path

import pytest

from benchmark.results import read_result

FILE = Path(__file__).parents[1] / ".ci/same_behaviour"


@pytest.fixture(scope="module")
def tool():
    sys.path.insert(0, str(FILE.parent))
    loader = importlib.machinery.SourceFileLoader("same_behaviour", str(FILE))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("same_behaviour", loader))
    loader.exec_module(module)
    sys.path.remove(str(FILE.parent))
    return module


def found(called="a1", **data):
    return {"data": data, "called": {"dataset": called}}


@pytest.mark.parametrize(
    "now, verdict",
    [
        (found(loss=1.0, keys=["a=1", "b=2"]), "same: 2 facts"),
        (found(loss=1.0, keys=["a=1", "b=2"], more=3), "same: 2 facts, 1 more are new"),
        (found(loss=2.0, keys=["a=1", "b=2"]), "DIFFERS in 1 of 2 facts: loss"),
        (found(loss=1.0), "DIFFERS in 1 of 2 facts: keys is gone"),
        (found(loss=1.0, words=["a=1", "b=2"]), "DIFFERS in 1 of 2 facts, 1 more are new: keys is now words"),
        (found(loss=1.0, keys=["a=1", "c=3"]), "DIFFERS in 1 of 2 facts: keys (-b=2 +c=3)"),
        (found(loss=1.0, keys=["b=2", "a=1"]), "DIFFERS in 1 of 2 facts: keys (another order)"),
        (found("b2", loss=1.0, keys=["a=1", "b=2"]), "DIFFERS in names alone: dataset; 2 facts"),
        ({"failed": "It ended with 1"}, "DIFFERS: before 2 facts; now failed: It ended with 1"),
    ],
)
def test_a_verdict_names_what_changed_and_what_is_gone(tool, now, verdict):
    assert tool.verdict(found(loss=1.0, keys=["a=1", "b=2"]), now) == verdict


def test_every_episode_of_a_result_is_a_fact(tool):
    path = next(FILE.parents[1].glob("results/v2/*/act/act_v2-*.json"))
    found = list(sys.modules["behaviour_facts"].of_result(path))
    result = read_result(path)
    assert len(found) == len(result.records) + 1
    record = result.records[-1]
    known = [record.initial_state_hash, record.success, record.length, record.episode_return]
    assert (f"level {record.level} alone {record.only} {record.split} {record.episode}", known) in found


def test_what_could_not_run_before_and_cannot_now_is_no_difference(tool):
    absent = {"skipped": "demos.h5 is absent"}
    assert tool.verdict(absent, absent) == "skipped: demos.h5 is absent"
    assert tool.verdict(None, found()) == "DIFFERS: it was not recorded"

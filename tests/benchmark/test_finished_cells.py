"""A killed evaluation resumes with its next cell."""

import json

import pytest

from benchmark.finished_cells import FinishedCells
from benchmark.protocol import Cell, Protocol
from benchmark.runner import evaluate

PROTOCOL = Protocol(levels=(0, 1), splits=("train", "test"), episodes=3)
KEY = {"weights": "abc", "protocol": PROTOCOL.to_json()}


def by_cell(records):
    return {cell: [record for record in records if record.cell == cell] for cell in PROTOCOL.cells()}


def test_finished_cells_come_back_as_they_were(tmp_path, make_records):
    cells = by_cell(make_records(PROTOCOL))
    first, second = PROTOCOL.cells()[:2]
    finished = FinishedCells(tmp_path / "run.json", KEY)
    assert finished.records == {}
    finished.add(first, cells[first])
    finished.add(second, cells[second])
    assert FinishedCells(tmp_path / "run.json", KEY).records == {first: cells[first], second: cells[second]}
    finished.remove()
    assert FinishedCells(tmp_path / "run.json", KEY).records == {}
    assert list(tmp_path.iterdir()) == []


def test_those_of_another_checkpoint_do_not_count(tmp_path, make_records):
    cell = PROTOCOL.cells()[0]
    FinishedCells(tmp_path / "run.json", KEY).add(cell, by_cell(make_records(PROTOCOL))[cell])
    assert FinishedCells(tmp_path / "run.json", KEY | {"weights": "abd"}).records == {}


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[: len(text) // 2],
        lambda text: "[]",
        lambda text: "null",
        lambda text: text.replace('"success"', '"succeeded"'),
        lambda text: json.dumps({"key": json.loads(text)["key"]}),
    ],
    ids=["cut short", "a list", "null", "another field", "no records"],
)
def test_damaged_file_is_reported_and_evaluated_again(tmp_path, make_records, caplog, damage):
    cell = PROTOCOL.cells()[0]
    finished = FinishedCells(tmp_path / "run.json", KEY)
    finished.add(cell, by_cell(make_records(PROTOCOL))[cell])
    finished.path.write_text(damage(finished.path.read_text()))
    assert FinishedCells(tmp_path / "run.json", KEY).records == {}
    assert "cannot be read" in caplog.text and "they are evaluated again" in caplog.text


def test_killed_evaluation_resumes_to_the_same_result(tmp_path, point_env, noisy_policy):
    def run(path, dies_in=None):
        made = []

        def make_env(cell):
            if cell == dies_in:
                raise KeyboardInterrupt
            made.append(cell)
            return point_env(2)

        finished = FinishedCells(path, KEY)
        records = evaluate(
            noisy_policy(),
            make_env,
            PROTOCOL,
            policy_name="noisy",
            on_cell=lambda cell, env, records: finished.add(cell, records),
            known=dict(finished.records),
        )
        return made, [(r.cell, r.episode, r.success, r.length, r.episode_return) for r in records]

    _, whole = run(tmp_path / "whole.json")
    last = Cell(level=1, split="test")
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "killed.json", dies_in=last)
    made, records = run(tmp_path / "killed.json")
    assert made == [last]
    assert records == whole

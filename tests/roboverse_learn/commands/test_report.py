"""What the commands print of an evaluation: success with known words and with held-out ones."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.table import Table

from benchmark.records import EpisodeRecord
from roboverse_learn import cli
from roboverse_learn.commands.outcomes import TrainedRun
from roboverse_learn.commands.report import collection_report, listed_paths, train_report, wording_table
from roboverse_learn.commands.suite import SuiteCollection
from roboverse_learn.commands.suite_report import suite_collection_report
from roboverse_learn.data.importers.verdicts import ImportSummary, Verdict
from roboverse_learn.teleoperation.report import teleoperation_report
from roboverse_learn.training.reporter import TrainResult
from tests.roboverse_learn.commands.test_train import SUMMARY

NUM = 10


def evaluation(task: str, **successes: int) -> Any:
    """Returns an evaluation whose first episodes of each instruction test succeed."""
    records = [
        EpisodeRecord(
            task=task, policy="mtact", level=0, only=None, channels=("task",), split="test", episode=episode,
            seed=0, initial_state_hash=f"{episode:016x}", success=episode < count, length=10,
            episode_return=0.0, wall_time_s=0.1, simulator="mujoco", renderer="warp", not_shown=(),
            versions={}, instruction_test=None if test == "own" else test,
        )
        for test, count in {"own": NUM, **successes}.items()
        for episode in range(NUM)
    ]  # fmt: skip
    return SimpleNamespace(
        result=SimpleNamespace(policy="mtact", env=SimpleNamespace(task=task), records=records)
    )


def rows(*evaluations: Any) -> list[list[str]]:
    table = wording_table(evaluations)
    assert table is not None
    return [[*map(str, cells)] for cells in zip(*(column.cells for column in table.columns), strict=True)]


def test_each_task_has_its_gaps_and_all_together_theirs():
    cube = evaluation("PickCube", known=9, new_frame=9, new_words=4)
    slider = evaluation("MoveSliderLeft", known=10, new_frame=8, new_words=10)
    found = {(task, kind): cells for task, kind, _, *cells in rows(cube, slider)}
    assert found["PickCube", "new frame"][:2] == ["90 %", "90 %"]
    assert found["PickCube", "new words"][:2] == ["90 %", "40 %"]
    assert found["PickCube", "new words"][2].startswith("+50 [")
    assert found["MoveSliderLeft", "new words"][:2] == ["100 %", "100 %"]
    assert found["all", "new frame"][:2] == ["95 %", "85 %"]
    assert found["all", "new words"][:2] == ["95 %", "70 %"]


def test_one_task_has_no_row_over_all():
    assert [row[0] for row in rows(evaluation("PickCube", known=9, new_words=4))] == ["PickCube"]


def test_a_task_without_the_known_wordings_has_no_row_and_no_part_of_all():
    known, without = evaluation("PickCube", known=9, new_words=4), evaluation("CloseBox", new_words=0)
    assert [row[0] for row in rows(known, without)] == ["PickCube"]
    other = evaluation("StackCube", known=8, new_words=8)
    assert rows(known, without, other) == rows(known, other)
    assert wording_table([without]) is None


FOLDER = f"datasets/grasp/few/{'long_' * 40}name"
COLLECTED = replace(SUMMARY, root=FOLDER)


def test_a_long_path_is_one_line_that_can_be_copied(capsys):
    for report in (
        collection_report(COLLECTED),
        suite_collection_report(
            SuiteCollection(suite="grasp/few", collected={"grasp/few/milk": COLLECTED}, failed={})
        ),
        listed_paths({"result": [FOLDER, "runs/a"], "page": None}),
    ):
        cli._show(report)
        lines = capsys.readouterr().out.splitlines()
        assert [line.split()[-1] for line in lines if "long_" in line] == [FOLDER]


def trained_run(**words: str) -> TrainedRun:
    trained = TrainResult(
        checkpoint=Path("runs/x/last"), steps=10, loss=0.5, elapsed_s=60.0, samples_per_s=10.0,
        stopped_by="steps", precision="fp32", plot=None,
    )  # fmt: skip
    facts: dict[str, Any] = {"dataset": SUMMARY} | words
    return TrainedRun(
        folder=Path("runs/x"), trained=trained, evaluations=(), board={}, stages={}, seconds=60.0, **facts
    )


IMPORTED = ImportSummary(
    source="robosuite", replay="states", files={}, conditions={},
    verdicts=(Verdict(file=FOLDER, name="demo_1", error="it is cut off"),),
)  # fmt: skip


@pytest.mark.parametrize(
    ("report", "sentence"),
    [
        (train_report(trained_run(dataset=f"Read 9 of '{FOLDER}'.")), f"Read 9 of '{FOLDER}'."),
        (train_report(trained_run(note=f"'{FOLDER}' has another robot.")), f"'{FOLDER}' has another robot."),
        (collection_report(replace(SUMMARY, imported=IMPORTED)), f"  {FOLDER} demo_1: it is cut off"),
        (
            suite_collection_report(
                SuiteCollection(suite="grasp/few", collected={}, failed={"milk": f"'{FOLDER}' is absent."})
            ),
            f"  milk: '{FOLDER}' is absent.",
        ),
        (
            teleoperation_report(Table(), Path("recordings"), None, None, f"roboverse collect from={FOLDER}"),
            f"Render them again, with other looks: roboverse collect from={FOLDER}",
        ),
    ],
)
def test_a_path_in_a_sentence_is_not_broken_into_lines(report, sentence, capsys):
    cli._show(report)
    assert sentence in capsys.readouterr().out.splitlines()


def test_names_of_paths_are_a_column_and_several_stand_below_one_another(capsys):
    cli._show(listed_paths({"result": ["a.json", "b.json"], "page": "p.html", "videos": [], "table": None}))
    assert capsys.readouterr().out == "result  a.json\n        b.json\npage    p.html\n"
    cli._show(listed_paths({"page": None}))
    assert capsys.readouterr().out == ""

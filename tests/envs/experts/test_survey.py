"""The survey of many tasks."""

import json

import pytest

from envs.core.errors import ConfigError, MissingAssetError
from envs.experts import survey


@pytest.mark.slow
def test_a_survey_writes_a_row_a_task_and_goes_on_where_it_ended(tmp_path, monkeypatch):
    results = tmp_path / "tasks.json"
    words = ["words=[PickCube]", "episodes=2", "num_envs=2", f"results={results}"]
    assert survey.main(words) == 0
    row = json.loads(results.read_text())["PickCube"]
    assert row["expert"] == 1.0 and row["episodes"] == 2 and not row["solved_at_start"]
    assert row["moved_m"] < 0.002
    command = "python -m envs.experts.survey 'words=[PickCube]' episodes=2 num_envs=2 results=tasks.json"
    assert row["command"] == command, "results are published"

    def refuse(name, settings):
        raise AssertionError(f"{name} is measured twice")

    monkeypatch.setattr(survey, "survey", refuse)
    assert survey.main(words) == 0


@pytest.mark.slow
def test_a_task_without_an_expert_is_looked_at_once(tmp_path, monkeypatch):
    results = tmp_path / "tasks.json"
    words = ["tasks=[control/cartpole]", f"results={results}"]
    assert survey.main(words) == 0
    row = json.loads(results.read_text())["control/cartpole"]
    assert row["expert"] is None and "episodes" not in row and row["moved_m"] == 0.0

    def refuse(name, settings):
        raise AssertionError(f"{name} is measured twice")

    monkeypatch.setattr(survey, "survey", refuse)
    assert survey.main(words) == 0


@pytest.mark.slow
def test_a_start_that_comes_to_be_solved_as_the_robot_holds_still_is_not_solved_at_the_start(tmp_path):
    """The block in the hand falls into the drawer when the fingers stay where they are."""
    results = tmp_path / "tasks.json"
    assert survey.main(["tasks=[calvin/A/place_in_drawer]", "episodes=1", f"results={results}"]) == 0
    row = json.loads(results.read_text())["calvin/A/place_in_drawer"]
    assert row["moved"].startswith("block_") and row["moved_m"] > 0.1
    assert row["solved_at_start"] is False and row["expert"] == 1.0


def without_a_cube(error):
    """Returns a survey of one task that raises the error for PickCube."""

    def survey_of(name, settings):
        if name == "PickCube":
            raise error
        return {"expert": 1.0, "episodes": settings.episodes}

    return survey_of


def test_a_task_that_fails_is_named_and_the_others_go_on(tmp_path, monkeypatch):
    results = tmp_path / "tasks.json"
    monkeypatch.setattr(survey, "survey", without_a_cube(ConfigError("no cube.")))
    assert survey.main(["words=[Cube]", f"results={results}"]) == 1
    rows = json.loads(results.read_text())
    assert rows["PickCube"]["error"] == "no cube." and rows["StackCube"]["expert"] == 1.0


def test_a_task_whose_files_are_not_here_is_left_out(tmp_path, monkeypatch, caplog):
    results = tmp_path / "tasks.json"
    missing = MissingAssetError("There is no cube. roboverse assets get cube")
    monkeypatch.setattr(survey, "survey", without_a_cube(missing))
    assert survey.main(["tasks=[PickCube,StackCube]", f"results={results}"]) == 0
    assert list(json.loads(results.read_text())) == ["StackCube"]
    assert "PickCube is left out" in caplog.text and "assets get cube" in caplog.text


def test_named_tasks_are_surveyed_and_no_others(tmp_path, monkeypatch, capsys):
    results = tmp_path / "tasks.json"
    monkeypatch.setattr(survey, "survey", lambda name, settings: {"episodes": settings.episodes})
    assert survey.main(["tasks=[StackCube,PickCube]", f"results={results}"]) == 0
    assert list(json.loads(results.read_text())) == ["PickCube", "StackCube"]
    assert survey.main(["tasks=[PickCub]", f"results={results}"]) == 2
    assert "Did you mean 'PickCube'?" in capsys.readouterr().err


def test_words_that_no_task_has_are_refused(tmp_path, capsys):
    assert survey.main(["words=[submarine]", f"results={tmp_path / 'a.json'}"]) == 2
    assert "No task has the words submarine in its name." in capsys.readouterr().err


def test_a_damaged_file_of_results_is_named(tmp_path):
    (tmp_path / "a.json").write_text("[1")
    with pytest.raises(ConfigError, match=r"a\.json has no rows of tasks"):
        survey.read_rows(tmp_path / "a.json")


class Interrupted(BaseException):
    """Ends a survey as a signal does."""


def surveyed(monkeypatch, results, *, at_most=99, sha="abc"):
    """Starts a survey again=true of four tasks; returns those that it measured until it was interrupted."""
    measured = []

    def measure(name, settings):
        if len(measured) == at_most:
            raise Interrupted
        measured.append(name)
        return {"episodes": settings.episodes, "expert": 1.0}

    monkeypatch.setattr(survey, "survey", measure)
    monkeypatch.setattr(survey, "git_sha", lambda: sha)
    words = ["tasks=[Door,Lift,PickCube,Stack]", f"results={results}", "again=true"]
    try:
        assert survey.main(words) == 0
    except Interrupted:
        assert len(measured) == at_most
    return measured


def test_an_interrupted_survey_of_all_tasks_again_goes_on_and_counts_nothing_twice(
    tmp_path, monkeypatch, caplog
):
    results = tmp_path / "tasks.json"
    with caplog.at_level("INFO"):
        assert surveyed(monkeypatch, results) == ["Door", "Lift", "PickCube", "Stack"]
        assert surveyed(monkeypatch, results, at_most=1) == ["Door"]  # complete: all are measured anew
        assert surveyed(monkeypatch, results, at_most=2) == ["Lift", "PickCube"]
        caplog.clear()
        assert surveyed(monkeypatch, results) == ["Stack"]
    said = caplog.messages[-1]
    assert "Measured 4 tasks in" in said and "min of wall time, " in said and "started 3 times" in said
    assert [path.name for path in tmp_path.glob(".*.survey.json")] == []
    assert surveyed(monkeypatch, results, at_most=1) == ["Door"]


def test_another_commit_or_command_measures_anew(tmp_path, monkeypatch):
    results = tmp_path / "tasks.json"
    assert surveyed(monkeypatch, results, at_most=3) == ["Door", "Lift", "PickCube"]
    assert surveyed(monkeypatch, results, at_most=2, sha="def") == ["Door", "Lift"]
    assert json.loads(results.read_text())["Lift"]["git_sha"] == "def"
    monkeypatch.setattr(survey, "survey", lambda name, settings: {"episodes": settings.episodes})
    assert survey.main(["tasks=[Door]", f"results={results}", "again=true", "episodes=3"]) == 0
    assert surveyed(monkeypatch, results, sha="def") == ["PickCube", "Stack"]


def test_a_task_that_failed_is_tried_again_when_the_survey_goes_on(tmp_path, monkeypatch):
    results, words = tmp_path / "tasks.json", ["tasks=[Door,Lift,Stack]", "again=true"]
    tried = []

    def measure(name, settings):
        tried.append(name)
        if name == "Door" and tried.count("Door") == 1:
            raise ConfigError("no door.")
        if name == "Stack" and tried.count("Stack") == 1:
            raise Interrupted
        return {"episodes": settings.episodes}

    monkeypatch.setattr(survey, "survey", measure)
    with pytest.raises(Interrupted):
        survey.main([*words, f"results={results}"])
    assert survey.main([*words, f"results={results}"]) == 0
    assert tried == ["Door", "Lift", "Stack", "Door", "Stack"]


def half_solved(name, settings):
    return {"expert": 0.5, "episodes": settings.episodes}


def test_an_error_is_over_once_a_task_is_counted(tmp_path, monkeypatch):
    results = tmp_path / "tasks.json"
    words = ["tasks=[PickCube,StackCube]", f"results={results}"]
    monkeypatch.setattr(survey, "survey", without_a_cube(ConfigError("no cube.")))
    assert survey.main(words) == 1
    monkeypatch.setattr(
        survey, "survey", lambda name, settings: {"expert": 0.5, "episodes": settings.episodes}
    )
    assert survey.main(words) == 0
    row = json.loads(results.read_text())["PickCube"]
    assert row["expert"] == 0.5 and "error" not in row


def test_counts_keep_the_command_that_counted_them(tmp_path, monkeypatch):
    results = tmp_path / "tasks.json"
    words = ["tasks=[Door]", f"results={results}"]
    monkeypatch.setattr(
        survey, "survey", lambda name, settings: {"expert": 0.5, "episodes": settings.episodes}
    )
    assert survey.main(words) == 0
    counted = json.loads(results.read_text())["Door"]
    monkeypatch.setattr(survey, "survey", lambda name, settings: {"rendered": True})
    assert survey.main([*words, "episodes=0", f"images={tmp_path / 'shots'}"]) == 0
    assert json.loads(results.read_text())["Door"] == counted | {"rendered": True}


def test_surveys_side_by_side_keep_each_others_rows(tmp_path, monkeypatch):
    results = tmp_path / "tasks.json"

    def measure(name, settings):
        if name == "Lift":  # another one ends meanwhile
            assert survey.main(["tasks=[Stack]", f"results={results}"]) == 0
        return {"episodes": settings.episodes}

    monkeypatch.setattr(survey, "survey", measure)
    assert survey.main(["tasks=[Lift]", f"results={results}"]) == 0
    assert list(json.loads(results.read_text())) == ["Lift", "Stack"]

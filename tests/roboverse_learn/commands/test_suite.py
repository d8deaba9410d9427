"""``suite=`` in place of ``task=``: every task, their mean, and what cannot run."""

import json
from dataclasses import replace

import pytest

from benchmark.leaderboard import suites_section
from benchmark.suites import read_suite
from envs.core.errors import ConfigError, UnknownNameError
from envs.tasks.suites import SUITES
from policies.zoo import source
from roboverse_learn import api, cli
from roboverse_learn.commands.suite import SuiteCollection, _run_name
from roboverse_learn.commands.suite_report import suite_collection_report
from roboverse_learn.config.compose import compose
from roboverse_learn.config.serialize import from_values, to_values
from roboverse_learn.sweep import plan

QUICK = ["levels=[0]", "splits=[test]", "episodes=2", "evaluate.num_envs=2", "videos=0"]


@pytest.fixture
def suite(monkeypatch):
    """A suite of two tasks, and a third that is not there."""
    monkeypatch.setattr(SUITES, "_entries", dict(SUITES._entries))
    SUITES.add("mixed", ("PickCube", "GoneTask", "MoveSliderLeft"), summary="for this test")
    return "mixed"


@pytest.mark.slow
def test_a_suite_is_evaluated_without_the_task_that_cannot_run(suite, tmp_path, capsys):
    words = ["evaluate", "policy=random", f"suite={suite}", *QUICK, f"results_dir={tmp_path}"]
    assert cli.main(words) == 1, "a task was left out"
    out = capsys.readouterr().out
    assert "mean of 2 tasks" in out and "Left out 1:" in out and "Unknown task 'GoneTask'" in out
    (path,) = tmp_path.glob("suites/mixed/random/*.json")
    found = read_suite(path)
    assert list(found.results) == ["PickCube", "MoveSliderLeft"] and list(found.failed) == ["GoneTask"]
    assert all((tmp_path / each).is_file() for each in found.results.values())
    board = json.loads((tmp_path / "leaderboard.json").read_text())
    ((row,),) = [each["rows"] for each in board["suites"]]
    assert (row["num_evaluated"], row["num_tasks"], row["cells"][0]["episodes"]) == (2, 3, 4)
    assert [task["task"] for task in row["tasks"] if task["reason"]] == ["GoneTask"]
    assert {section["task"] for section in board["sections"]} == {"PickCube", "MoveSliderLeft"}
    for page in ("leaderboard.html", "leaderboard.md"):
        text = (tmp_path / page).read_text()
        assert "mixed" in text and "GoneTask" in text and "2 of 3" in text
    written = path.read_text()
    assert cli.main(words) == 1
    before, after = json.loads(written), json.loads(path.read_text())
    assert before["results"] == after["results"] and before["cells"] == after["cells"]


@pytest.mark.slow
def test_tasks_of_a_large_suite_have_no_section_of_their_own(suite, tmp_path, monkeypatch):
    monkeypatch.setattr(suites_section, "MOST_SECTIONS", 2)
    words = ["evaluate", "policy=random", f"suite={suite}", *QUICK, f"results_dir={tmp_path}"]
    cli.main(words)
    board = json.loads((tmp_path / "leaderboard.json").read_text())
    assert board["sections"] == [] and len(board["suites"]) == 1
    next(tmp_path.glob("v2/PickCube/random/*.json")).unlink()
    cli.main(["leaderboard", f"results_dir={tmp_path}"])
    (section,) = json.loads((tmp_path / "leaderboard.json").read_text())["suites"]
    gone = next(task for task in section["rows"][0]["tasks"] if task["task"] == "PickCube")
    assert gone["reason"] == "its result is no longer in this folder"


@pytest.mark.slow
def test_a_suite_is_collected_into_a_dataset_for_each_task(suite, tmp_path, capsys):
    words = ["num_demos=1", "image_size=16", "collect.num_envs=1", "collect.num_workers=1"]
    assert cli.main(["collect", f"suite={suite}", *words, f"datasets_dir={tmp_path}"]) == 1
    assert "Unknown task 'GoneTask'" in capsys.readouterr().out
    for task in ("PickCube", "MoveSliderLeft"):
        (folder,) = (tmp_path / task).iterdir()
        assert json.loads((folder / "meta" / "info.json").read_text())["total_episodes"] == 1


def test_a_suite_none_of_which_can_run_is_an_error(monkeypatch, tmp_path):
    monkeypatch.setattr(SUITES, "_entries", dict(SUITES._entries))
    SUITES.add("gone", ("GoneTask", "LostTask"))
    with pytest.raises(ConfigError, match=r"No task of the suite 'gone' could run: Unknown task 'GoneTask'"):
        api.evaluate("random", suite="gone", results_dir=str(tmp_path))


def test_a_suite_that_a_checkpoint_did_not_learn_is_refused_with_one_reason(monkeypatch, tmp_path, caplog):
    monkeypatch.setattr(SUITES, "_entries", dict(SUITES._entries))
    SUITES.add("others", ("StackCube", "CloseBox", "GoneTask"))
    content = {"type": "ppo", "tasks": {"PickCube": {}, "PushCube": {}}, "observation": {}}
    (tmp_path / "config.json").write_text(json.dumps(content))
    (tmp_path / "model.safetensors").touch()
    with pytest.raises(ConfigError, match=r"the tasks PickCube and PushCube, not StackC.* 1 other r") as said:
        api.evaluate(str(tmp_path), suite="others", image_size=64, results_dir=str(tmp_path))
    assert "CloseBox" not in str(said.value)
    logged = [record.getMessage() for record in caplog.records if "left out" in record.getMessage()]
    assert logged[1] == "CloseBox is left out: the same as for StackCube"
    assert "not StackCube. Give" in logged[0] and "Unknown task 'GoneTask'" in logged[2]


def test_a_report_says_a_reason_of_several_tasks_once():
    why = {task: f"It did not learn {task}." for task in ("A1", "B1")} | {"C1": "It has no expert."}
    report = suite_collection_report(SuiteCollection(suite="any", collected={}, failed=why))
    said = str(report.renderables[-1])
    assert said.splitlines()[1:] == [
        "  A1: It did not learn A1.", "  B1: the same as for A1", "  C1: It has no expert."
    ]  # fmt: skip


def test_options_that_one_task_lacks_are_said_of_that_task(suite, tmp_path):
    with pytest.raises(ConfigError, match=r"No task of the suite .* Unknown option of PickCube 'no_such'"):
        api.evaluate("random", suite=suite, task_kwargs={"no_such": 1}, results_dir=str(tmp_path))


@pytest.mark.parametrize(
    ("command", "words", "error", "said"),
    [
        ("evaluate", ["policy=random", "suite=papr"], UnknownNameError, "'papr'. Did you mean 'paper'"),
        ("evaluate", ["policy=random", "suite=paper", "task=PickCube"], ConfigError, "leave one out"),
        ("collect", ["suite=paper", "task=PickCube"], ConfigError, "leave one out"),
        ("collect", ["suite=paper", "dataset=one"], ConfigError, "datasets_dir=<folder>"),
        ("train", ["suite=paper"], ConfigError, "roboverse sweep suite=paper"),
        ("sweep", ["suite=paper", "tasks=[PickCube]"], ConfigError, "leave one out"),
    ],
)
def test_a_suite_where_none_fits_is_refused_with_what_to_do(command, words, error, said):
    with pytest.raises(error, match=said):
        compose(command, words)


def test_one_call_from_python_collects_one_dataset():
    with pytest.raises(ConfigError, match=r"call it for each of envs.tasks.suites.suite_tasks"):
        api.collect(suite="paper")


def test_a_suite_survives_the_saved_configuration():
    config = compose("evaluate", ["policy=random", "suite=paper", "simulator=mujoco"])
    assert config.suite == "paper" and config.env == {"simulator": "mujoco"}
    assert from_values("evaluate", to_values(config)) == config


def test_a_sweep_over_a_suite_is_one_over_its_tasks():
    swept = plan(["policy=act", "suite=paper", "level=0,3", "preset=quick"])
    assert [run.env.task for _, run in swept.runs][:2] == ["PickCube", "StackCube"] and len(swept.runs) == 12
    with pytest.raises(ConfigError, match="task=PickCube and suite=paper are both given"):
        plan(["policy=act", "suite=paper", "task=PickCube"])


def test_a_recipes_sweep_takes_the_tasks_of_a_suite():
    swept = plan(["recipe=act_v1", "suite=maniskill", "levels=[0]", "seeds=[0]"])
    assert len(swept.runs) == 15 and swept.runs[0][1].recipe == "act_v1"


@pytest.mark.parametrize("weights", ["adapter_model.safetensors", "model.safetensors.index.json"])
def test_an_evaluation_of_a_checkpoint_without_one_file_of_weights_has_a_name(weights, tmp_path):
    folder = tmp_path / "tuned" / "pretrained_model"
    folder.mkdir(parents=True)
    (folder / "config.json").write_text("{}")
    (folder / weights).write_text("first")
    config = compose("evaluate", [f"checkpoint={tmp_path / 'tuned'}", "suite=paper"])
    before = _run_name(config)
    mapped = compose(
        "evaluate", [f"checkpoint={tmp_path / 'tuned'}", "suite=paper", "rename_map={front: top}"]
    )
    assert _run_name(mapped) not in (before, _run_name(replace(mapped, rename_map={"front": "side"})))
    (folder / weights).write_text("second")
    assert before.startswith("tuned-") and _run_name(config) != before


def test_an_evaluation_of_a_checkpoint_of_the_hub_has_its_name(tmp_path, monkeypatch):
    folder = tmp_path / "snapshots" / "0123abcd"
    folder.mkdir(parents=True)
    (folder / "model.safetensors").write_text("weights")
    monkeypatch.setattr(source, "local_folder", lambda path: folder if path == "owner/name" else None)
    assert _run_name(compose("evaluate", ["checkpoint=owner/name", "suite=paper"])).startswith("owner-name-")

"""In which tasks a checkpoint is evaluated: those that it learned, and others where they are asked for."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from envs.core.errors import PolicyError
from envs.tasks.suites import SUITES
from policies.checkpoint import check_learned
from roboverse_learn.commands import chains
from roboverse_learn.commands.run_folder import RunFolder
from roboverse_learn.commands.suite import evaluate_suite
from roboverse_learn.commands.tested_checkpoint import TestedCheckpoint, checkpoints_to_test
from roboverse_learn.config.compose import compose
from tests.roboverse_learn.commands.test_tested_checkpoint import ACT, to_test, write_checkpoint


def write_run(words: list[str], content: dict[str, Any]) -> Path:
    """Writes a run with one checkpoint; returns its folder."""
    with RunFolder.open(compose("train", [*words, "device=cpu"]), ["roboverse", "train"]) as opened:
        with opened.stage("collect") as facts:
            facts.update(dataset_hash="0" * 64, num_episodes=400)
        write_checkpoint(opened.folder / "checkpoints/000100/pretrained_model", content)
        (opened.folder / "checkpoints/last").symlink_to("000100")
        return opened.folder


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return write_run(["policy=act", "preset=quick"], ACT)


@pytest.fixture
def agent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Returns a run of reinforcement learning, whose checkpoint names its task."""
    monkeypatch.chdir(tmp_path)
    return write_run(["policy=ppo"], {"type": "ppo", "task": "PickCube", "config": {}, "observation": {}})


def all_to_test(checkpoint: Path, *words: str) -> list[TestedCheckpoint]:
    return checkpoints_to_test(
        compose("evaluate", [f"checkpoint={checkpoint}", "preset=quick", "device=cpu", *words])
    )


def test_a_task_that_a_run_did_not_learn_is_refused_with_what_to_type(run: Path) -> None:
    with pytest.raises(PolicyError) as error:
        all_to_test(run, "task=StackCube")
    said = str(error.value)
    assert "of policy 'act' learned the task PickCube, not StackCube. Give task=PickCube, or train" in said
    assert "or evaluate it there nevertheless with other_tasks=true." in said
    with pytest.raises(PolicyError, match="learned the task PickCube, not StackCube"):
        all_to_test(run / "checkpoints/000100", "task=[PickCube,StackCube]")


def test_many_learned_tasks_are_named_in_part(run: Path) -> None:
    names = tuple(f"task{index}" for index in range(9))
    checkpoint = run / "checkpoints/last/pretrained_model"
    with pytest.raises(
        PolicyError, match=r"the tasks task0, .*, task4 and 4 more, not StackCube\. Give"
    ) as said:
        check_learned(checkpoint, "StackCube", names)
    assert "task5" not in str(said.value)


def test_chains_are_run_whatever_scene_was_learned(run: Path) -> None:
    config = compose("evaluate", [f"checkpoint={run}", "device=cpu"])
    assert chains._tested(config, "StackCube").env.task == "StackCube"


def test_another_task_that_is_asked_for_names_the_one_that_was_learned(run: Path) -> None:
    (found,) = all_to_test(run, "task=StackCube", "other_tasks=true")
    assert (found.env.task, found.training.tasks) == ("StackCube", ("PickCube",))
    assert found.run == to_test(run).run + "-StackCube"
    for words in ([], ["task=PickCube"], ["task=PickCube", "other_tasks=true"], ["robot=ur5e"]):
        (own,) = all_to_test(run, *words)
        assert (own.env.task, own.training.tasks) == ("PickCube", ())


@pytest.mark.parametrize("words", [[], ["other_tasks=true"]], ids=" ".join)
def test_an_agent_is_refused_in_another_task_whatever_is_asked_for(agent: Path, words: list[str]) -> None:
    with pytest.raises(
        PolicyError, match=r"'ppo' learned the task PickCube, not StackCube\. Give task=PickC"
    ):
        all_to_test(agent, "task=StackCube", *words)


def test_a_checkpoint_of_which_nothing_is_known_is_tested_in_any_task(tmp_path: Path) -> None:
    folder = write_checkpoint(tmp_path / "their run/model")
    tested = all_to_test(folder, "task=[PickCube,StackCube]")
    assert [(each.env.task, each.training.tasks) for each in tested] == [("PickCube", ()), ("StackCube", ())]


@pytest.mark.parametrize(
    ("named", "refused"),
    [({"tasks": []}, False), ({"tasks": ["PickCube"]}, True), ({"tasks": ["StackCube"]}, False), ({}, True)],
)
def test_a_run_of_a_given_dataset_learned_the_tasks_that_its_episodes_name(
    run: Path, named: dict[str, Any], refused: bool
) -> None:
    values = yaml.safe_load((run / "config.yaml").read_text()) | {"dataset": "theirs"}
    (run / "config.yaml").write_text(yaml.safe_dump(values))
    path = run / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["stages"]["collect"].update(named)
    path.write_text(json.dumps(manifest))
    if refused:
        with pytest.raises(PolicyError, match="learned the task PickCube, not StackCube"):
            all_to_test(run, "task=StackCube")
    else:
        assert [each.env.task for each in all_to_test(run, "task=StackCube")] == ["StackCube"]


def test_tasks_of_a_suite_that_a_run_did_not_learn_are_left_out_unless_asked_for(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SUITES, "_entries", dict(SUITES._entries))
    SUITES.add("pair", ("PickCube", "StackCube"))

    def evaluated(*words: str) -> tuple[list[str], dict[str, str]]:
        tested: dict[str, TestedCheckpoint] = {}

        def evaluate(one: TestedCheckpoint) -> Any:
            tested[one.env.task] = one
            return SimpleNamespace(result=SimpleNamespace(policy="act"), path=None)

        monkeypatch.setattr("benchmark.suites.summarize_suite", lambda results: ())
        monkeypatch.setattr("benchmark.suites.write_suite", lambda *args: Path("suite.json"))
        given = compose("evaluate", [f"checkpoint={run}", "suite=pair", "device=cpu", *words])
        failed = evaluate_suite(given, evaluate).failed
        return list(tested), dict(failed)

    tested, failed = evaluated()
    assert tested == ["PickCube"]
    assert list(failed) == ["StackCube"] and "other_tasks=true" in failed["StackCube"]
    assert evaluated("other_tasks=true") == (["PickCube", "StackCube"], {})

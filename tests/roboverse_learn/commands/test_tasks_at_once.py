"""``tasks_at_once=``: processes that collect and evaluate beside each other, for one that does the rest."""

import json
import logging
import re
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.results import read_result
from envs.core.errors import ConfigError, PolicyError
from envs.core.machine import num_cores
from envs.tasks.suites import SUITES
from roboverse_learn import cli
from roboverse_learn.collect import dataset_folder
from roboverse_learn.commands import tasks_at_once
from roboverse_learn.commands.collected import of_task
from roboverse_learn.commands.run_folder import read_facts
from roboverse_learn.commands.run_identity import identity
from roboverse_learn.commands.tested_checkpoint import checkpoint_to_test
from roboverse_learn.config.compose import compose
from roboverse_learn.data import DatasetInfo
from roboverse_learn.evaluate import evaluate_all
from tests.roboverse_learn.commands.test_tested_checkpoint import write_checkpoint
from tests.roboverse_learn.training.imitation.test_several_tasks_command import LIST, TINY

TASKS = ("PickCube", "StackCube")


@pytest.fixture
def started(monkeypatch):
    """What is started in place of processes: words of the jobs, and the slots; there are two GPUs."""
    seen = []

    def run(jobs, slots, logs, on_end):
        assert len({job.name for job in jobs}) == len(jobs)
        seen.append(([job.words for job in jobs], slots))
        return dict.fromkeys((job.name for job in jobs), 0)

    gpus = [{"CUDA_VISIBLE_DEVICES": str(gpu)} for gpu in range(2)]
    monkeypatch.setattr(tasks_at_once, "run_processes", run)
    monkeypatch.setattr(tasks_at_once, "gpu_slots", lambda per_gpu: gpus * per_gpu)
    return seen


def test_each_task_is_collected_by_the_command_of_that_task_alone(started):
    config = compose("train", ["policy=mtact", LIST, *TINY, "collect.num_workers=0", "tasks_at_once=2"])
    tasks_at_once.collect_in_parallel([of_task(config, task) for task in config.tasks])
    (((one, two), slots),) = started
    assert [slot["CUDA_VISIBLE_DEVICES"] for slot in slots] == ["0", "1"]
    for task, (name, *words) in zip(TASKS, (one, two), strict=True):
        alone = compose("collect", words)
        assert name == "collect" and alone.tasks_at_once == 1
        workers = max(1, num_cores() // 2)  # the two share the cores
        assert alone.collect == replace(config.collect, num_workers=workers)
        assert dataset_folder(alone) == dataset_folder(of_task(config, task))


@pytest.mark.parametrize(
    ("device", "gpus"), [("auto", ["0", "1", "0"]), ("cuda:1", [None] * 3), ("cpu", [None] * 3)]
)
def test_each_task_is_evaluated_by_the_command_of_that_task_alone(started, device, gpus):
    words = ["checkpoint=runs/x", "levels=[0,3]", "episodes=7", "cameras=[front]", f"device={device}"]
    config, tasks = compose("evaluate", [*words, "tasks_at_once=8"]), ["a/b", "a-b", "PickCube"]
    tasks_at_once.evaluate_in_parallel(config, tasks)
    ((commands, slots),) = started
    assert [slot.get("CUDA_VISIBLE_DEVICES") for slot in slots] == gpus, "as many as there are tasks"
    for task, (name, *words) in zip(tasks, commands, strict=True):
        assert name == "evaluate" and f"task={task}" in words
    alone = compose("evaluate", commands[2][1:])
    assert alone == replace(config, env={**config.env, "task": "PickCube"}, tasks_at_once=1)


@pytest.mark.parametrize(("at_once", "tasks"), [(1, TASKS), (4, TASKS[:1])])
def test_one_at_a_time_and_one_task_start_no_process(started, at_once, tasks):
    config = compose("evaluate", ["checkpoint=runs/x", f"tasks_at_once={at_once}"])
    tasks_at_once.evaluate_in_parallel(config, tasks)
    of_one = compose("collect", ["task=PickCube", f"tasks_at_once={at_once}"])
    tasks_at_once.collect_in_parallel([of_one] * len(tasks))
    assert started == []


def test_a_task_of_a_suite_that_was_not_learned_starts_no_process(started, tmp_path, monkeypatch):
    monkeypatch.setattr(SUITES, "_entries", dict(SUITES._entries))
    SUITES.add("three", (*TASKS, "PushCube"), summary="for this test")
    folder = write_checkpoint(
        tmp_path / "agent", {"type": "tdmpc2", "observation": {}, "tasks": dict.fromkeys(TASKS)}
    )
    words = [f"checkpoint={folder}", "suite=three", "device=cpu", "tasks_at_once=3"]
    with pytest.raises(PolicyError, match="learned the tasks PickCube and StackCube, not PushCube"):
        checkpoint_to_test(compose("evaluate", [*words[:1], "task=PushCube"]))
    with pytest.raises(ConfigError, match="No task of the suite 'three' could run"):  # it has no weights
        evaluate_all(compose("evaluate", [*words, f"results_dir={tmp_path}"]))
    ((commands, _),) = started
    assert [compose("evaluate", words).env["task"] for _, *words in commands] == list(TASKS)


def test_how_many_tasks_run_at_once_changes_no_run():
    one, six = (compose("train", ["recipe=mtact_paper", *more]) for more in ([], ["tasks_at_once=6"]))
    assert six.tasks_at_once == 6 and identity(six) == identity(one)


def test_chains_are_not_tasks():
    words = ["checkpoint=runs/x", "suite=calvin", "chains=10", "tasks_at_once=2"]
    with pytest.raises(ConfigError, match=r"tasks_at_once=2 is for tasks, and chains=10 .* num_envs"):
        compose("evaluate", words)


def logs_of(text):
    """Returns the folders of logs that a command names."""
    return re.findall(r"Their logs, until all have succeeded: (\S+)", text)


@pytest.mark.slow
def test_tasks_at_once_leave_nothing_to_do_but_training(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    with caplog.at_level(logging.INFO):
        assert cli.main(["train", "policy=mtact", LIST, *TINY, "tasks_at_once=2"]) == 0
    done = re.findall(r"\d of 2: \d-(\S+) done", caplog.text)
    assert sorted(done) == [f"{what}-{task}" for what in ("collect", "evaluate") for task in TASKS]
    assert caplog.text.count("Evaluated before: level 0, test split") == 2
    assert not any(Path(logs).exists() for logs in logs_of(caplog.text)), "none failed"
    (run,) = (tmp_path / "runs/PickCube/mtact").iterdir()
    for task, folder in read_facts(run, "collect")["folder"].items():
        assert DatasetInfo.open(tmp_path / folder).num_episodes == 2
        result = read_result(tmp_path / "results/v2" / task / "mtact" / f"{run.name}.json")
        assert (result.env.task, result.train_tasks) == (task, TASKS)
        assert "roboverse_learn/train.py policy=mtact" in result.command, "as without other processes"
        assert not list((tmp_path / "results/v2" / task / "mtact").glob(".*.cells.json"))


@pytest.mark.slow
def test_a_suites_result_is_the_same_and_a_task_that_failed_is_tried_again(tmp_path, monkeypatch, caplog):
    words = ["evaluate", "policy=random", "levels=[0]", "splits=[test]", "episodes=1", "videos=0"]
    monkeypatch.setattr(SUITES, "_entries", dict(SUITES._entries))
    SUITES.add("pair", TASKS, summary="for this test")
    run, failing = tasks_at_once.run_processes, []

    def one_fails(jobs, slots, logs, on_end):
        failing.append(jobs[1].name)
        broken = replace(jobs[1], words=(*jobs[1].words, "no_such_key=1"))
        return run([jobs[0], broken], slots, logs, on_end)

    monkeypatch.setattr(tasks_at_once, "run_processes", one_fails)
    found = []
    for at_once in (1, 2):
        folder = tmp_path / str(at_once)
        with caplog.at_level(logging.INFO):
            assert cli.main([*words, "suite=pair", f"results_dir={folder}", f"tasks_at_once={at_once}"]) == 0
        (path,) = folder.glob("suites/pair/random/*.json")
        found.append(json.loads(path.read_text())["cells"])
    assert found[0] == found[1] and failing == ["2-evaluate-StackCube"]
    assert "1-evaluate-PickCube done" in caplog.text
    assert re.search(r"2-evaluate-StackCube ended with code [1-9]\d*; it is tried again", caplog.text)
    assert "no_such_key" in Path(logs_of(caplog.text)[-1], "2-evaluate-StackCube.log").read_text()

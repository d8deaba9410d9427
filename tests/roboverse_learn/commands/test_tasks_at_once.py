"""``tasks_at_once=``: processes that collect and evaluate beside each other, for one that does the rest."""

import logging
import re

import pytest

from benchmark.results import read_result
from roboverse_learn import cli
from roboverse_learn.collect import dataset_folder
from roboverse_learn.commands import tasks_at_once
from roboverse_learn.commands.collected import of_task
from roboverse_learn.commands.run_folder import identity, read_facts
from roboverse_learn.config.compose import compose
from roboverse_learn.data import DatasetInfo
from tests.roboverse_learn.training.imitation.test_several_tasks_command import LIST, TINY

TASKS = ("PickCube", "StackCube")


@pytest.fixture
def started(monkeypatch):
    """The jobs that are started in place of processes, and how many run at once."""
    seen = []
    monkeypatch.setattr(
        tasks_at_once.LocalLauncher,
        "run",
        lambda self, jobs, logs, on_end: seen.append((self.jobs_per_gpu, [job.words for job in jobs])),
    )
    return seen


def test_each_task_is_collected_by_the_command_of_that_task_alone(started):
    config = compose("train", ["policy=mtact", LIST, *TINY, "tasks_at_once=2"])
    tasks_at_once.collect_ahead([of_task(config, task) for task in config.tasks])
    ((at_once, commands),) = started
    assert at_once == 2 and [name for name, *_ in commands] == ["collect", "collect"]
    for task, (_, *words) in zip(TASKS, commands, strict=True):
        alone = compose("collect", words)
        assert alone.tasks_at_once == 1 and alone.collect == config.collect
        assert dataset_folder(alone) == dataset_folder(of_task(config, task))


def test_each_task_is_evaluated_by_the_command_of_that_task_alone(started):
    words = ["checkpoint=runs/x", "levels=[0,3]", "episodes=7", "cameras=[front]", "tasks_at_once=8"]
    config, tasks = compose("evaluate", words), ["PickCube", "calvin/D/open_drawer"]
    tasks_at_once.evaluate_ahead(config, tasks)
    ((at_once, commands),) = started
    assert at_once == 2, "there are no more tasks"
    for task, (name, *words) in zip(tasks, commands, strict=True):
        alone = compose("evaluate", words)
        assert name == "evaluate" and alone.evaluate == config.evaluate and alone.checkpoint == "runs/x"
        assert alone.env == {**config.env, "task": task} and alone.tasks_at_once == 1


@pytest.mark.parametrize(("at_once", "tasks"), [(1, TASKS), (4, TASKS[:1])])
def test_one_at_a_time_and_one_task_start_no_process(started, at_once, tasks):
    config = compose("evaluate", ["checkpoint=runs/x", f"tasks_at_once={at_once}"])
    tasks_at_once.evaluate_ahead(config, tasks)
    assert started == []


def test_how_many_tasks_run_at_once_changes_no_run():
    one, six = (compose("train", ["recipe=mtact_paper", *more]) for more in ([], ["tasks_at_once=6"]))
    assert six.tasks_at_once == 6 and identity(six) == identity(one)


@pytest.mark.slow
def test_tasks_at_once_leave_nothing_to_do_but_training(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    with caplog.at_level(logging.INFO):
        assert cli.main(["train", "policy=mtact", LIST, *TINY, "tasks_at_once=2"]) == 0
    done = re.findall(r"\d of 2: (\S+) done", caplog.text)
    assert sorted(done) == [f"{what}-{task}" for what in ("collect", "evaluate") for task in TASKS]
    assert caplog.text.count("Evaluated before") == 2
    (run,) = (tmp_path / "runs/PickCube/mtact").iterdir()
    for task, folder in read_facts(run, "collect")["folder"].items():
        assert DatasetInfo.open(tmp_path / folder).num_episodes == 2
        result = read_result(tmp_path / "results/v2" / task / "mtact" / f"{run.name}.json")
        assert (result.env.task, result.train_tasks) == (task, TASKS)


@pytest.mark.slow
def test_a_task_that_a_process_cannot_do_is_named_and_tried_again(tmp_path, caplog):
    words = ["policy=expert", "task=PickCube", "levels=[0]", "splits=[test]", "episodes=1", "videos=0"]
    config = compose("evaluate", [*words, f"results_dir={tmp_path}", "tasks_at_once=2"])
    with caplog.at_level(logging.INFO):
        tasks_at_once.evaluate_ahead(config, ["PickCube", "GoneTask"])
    assert "evaluate-PickCube done" in caplog.text
    assert re.search(r"evaluate-GoneTask ended with code [1-9]\d*, and is tried again", caplog.text)
    assert list(tmp_path.glob("v2/PickCube/expert/*.json"))

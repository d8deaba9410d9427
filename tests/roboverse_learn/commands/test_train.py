"""The glue of the main command: what it refuses, where datasets lie, what it prints."""

import dataclasses
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from benchmark.protocol import Protocol
from benchmark.records import Checkpoint, EpisodeRecord, Machine, Result
from envs.core.errors import ConfigError
from envs.spec import EnvSpec
from roboverse_learn import cli
from roboverse_learn import train as command
from roboverse_learn.collect import dataset_folder
from roboverse_learn.commands.dataset_layout import dataset_layout
from roboverse_learn.commands.outcomes import Evaluation, TrainedRun
from roboverse_learn.commands.report import (
    collection_report,
    evaluation_report,
    instruction_table,
    success_table,
    train_report,
)
from roboverse_learn.commands.run_folder import RunFolder
from roboverse_learn.commands.tested_checkpoint import protocol_of
from roboverse_learn.config.compose import compose
from roboverse_learn.data.collection.collect import CollectionSummary
from roboverse_learn.training import metrics
from roboverse_learn.training.learners import Learner
from roboverse_learn.training.reporter import TrainResult

HOUR = 3600.0


def printed(renderable: Any) -> str:
    console = Console(width=140)
    with console.capture() as capture:
        console.print(renderable)
    return capture.get()


class Timed(Learner):
    """Training that takes some hours; None where the estimate must not run."""

    def __init__(self, hours: float | None, *words: str, device: str = "cpu") -> None:
        super().__init__(compose("train", words), device)
        self.hours = hours

    def estimate_s(self) -> float:
        assert self.hours is not None, "the estimate is not needed"
        return self.hours * HOUR


@pytest.mark.parametrize(("hours", "said"), [(1.1, "66 minutes"), (30, "30 hours"), (480, "20.0 days")])
def test_full_size_run_without_gpu_estimates_time_and_names_preset(hours: float, said: str) -> None:
    with pytest.raises(ConfigError, match=rf"about {said} on this machine.*preset=quick.*slow_ok=true"):
        command.refuse_long_run(Timed(hours))


def test_a_run_that_is_short_or_wanted_or_on_a_gpu_is_not_refused() -> None:
    command.refuse_long_run(Timed(0.5))
    command.refuse_long_run(Timed(200, "preset=quick"))  # a machine may be busy now
    command.refuse_long_run(Timed(None, "slow_ok=true"))
    command.refuse_long_run(Timed(None, device="cuda"))
    command.refuse_long_run(Timed(None, "train.time_limit_s=60"))


def test_processes_that_would_choose_a_folder_each_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("WORLD_SIZE", "2")
    for rank in ("0", "1"):
        monkeypatch.setenv("RANK", rank)
        with pytest.raises(
            ConfigError, match=r"resume=false begins a run in a new folder, .* add run=<folder>"
        ):
            command.train_run(compose("train", ["preset=quick", "resume=false"]))
    assert not any(tmp_path.iterdir())


def test_missing_login_is_refused_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail() -> None:
        raise ConfigError("Run `wandb login`")

    monkeypatch.setattr(metrics, "check_wandb", fail)
    folders = [f"{key}={tmp_path / key}" for key in ("datasets_dir", "runs_dir", "results_dir")]
    with pytest.raises(ConfigError, match="wandb login"):
        command.train(compose("train", ["device=cpu", "slow_ok=true", "train.wandb=true", *folders]))
    assert not list(tmp_path.iterdir())


def test_a_dataset_is_named_after_what_is_in_it() -> None:
    base = dataset_folder(compose("collect", ["num_demos=20", "image_size=96"]))
    assert base == Path("datasets/PickCube/level0-mujoco-warp-96px-20demos")
    others = [
        "level=1",
        "only=camera",
        "renderer=gl",
        "num_demos=21",
        "image_size=64",
        "task_kwargs.variant=lift",
        "simulator_settings.impratio=5",
        "scenario.physics.decimation=50",
        "scenario.physics.decimation=5",
        "materials=photos",
        "materials=+photos",
    ]
    folders = {dataset_folder(compose("collect", ["num_demos=20", "image_size=96", word])) for word in others}
    assert len(folders | {base}) == len(others) + 1
    assert dataset_folder(compose("collect", ["dataset=here"])) == Path("here")


def test_training_and_collecting_agree_on_the_dataset() -> None:
    words = ["preset=quick", "level=2", "num_demos=5"]
    assert dataset_folder(compose("collect", words)) == dataset_folder(compose("train", words))


def test_the_layout_of_a_dataset_follows_from_the_task() -> None:
    features, fps, robot = dataset_layout(compose("collect", ["image_size=64"]))
    assert features["observation.images.front"]["shape"] == [64, 64, 3]
    assert len(features["action"]["names"]) == features["action"]["shape"][0] == 9
    assert (fps, robot) == (20, "franka")


def test_a_protocol_says_what_the_configuration_says() -> None:
    config = compose(
        "train", ["levels=[1]", "alone=[camera]", "splits=[test]", "episodes=7", "protocol_seed=3"]
    )
    assert protocol_of(config.evaluate) == Protocol(
        levels=(1,), only=("camera",), splits=("test",), episodes=7, seed=3
    )


@pytest.fixture
def evaluation() -> Evaluation:
    protocol = Protocol(levels=(0,), splits=("train", "test"), episodes=2)
    records = [
        EpisodeRecord(
            task="PickCube", policy="act", level=0, channels=("task",), split=split, episode=episode, seed=0,
            initial_state_hash="0123456789abcdef", success=split == "train" or episode == 1, length=9,
            episode_return=1.5, wall_time_s=0.25, simulator="mujoco", renderer="warp",
            not_shown=("metallic",),
        )
        for split in protocol.splits for episode in (1, 2)
    ]  # fmt: skip
    result = Result(
        run="r", created="2026-01-01T00:00:00Z", protocol=protocol, env=EnvSpec(image_size=64),
        max_episode_steps=100,
        control_hz=20.0, policy="act", train_level=0, seed=0,
        dataset_hash=None, checkpoint=Checkpoint(step=1, hash="c" * 64), demonstrations=None,
        git=None, command="python x", records=tuple(records),
        machine=Machine(device="cpu", cpu_count=2),
    )  # fmt: skip
    return Evaluation(
        path=Path("results/r.json"), result=result, videos=tuple(Path(f"{i}.mp4") for i in range(9))
    )


BOARD = {
    "json": Path("results/leaderboard.json"),
    "markdown": Path("results/leaderboard.md"),
    "html": Path("results/leaderboard.html"),
    "plot a": Path("results/plots/a.png"),
}
SUMMARY = CollectionSummary(
    root="datasets/x",
    num_episodes=9,
    num_frames=900,
    num_attempts=10,
    success_rate=0.9,
    wall_time_s=61.0,
    dataset_hash="f" * 64,
    outcome="the expert succeeded in 90.0 % of 10 episodes",
)


def test_the_table_has_the_test_split_first_with_its_interval(evaluation: Evaluation) -> None:
    said = printed(evaluation_report([evaluation], BOARD))
    assert "PickCube, act, trained on level 0: success in 2 episodes" in said
    header, row = (
        next(line for line in said.splitlines() if word in line) for word in ("evaluated on", "level 0  ")
    )
    assert header.index("test split") < header.index("train split")
    assert "50 % [9, 91]" in row and "100 % [34, 100]" in row and "metallic" in row


@pytest.mark.parametrize(
    ("changes", "scene"),
    [
        ({"robot": "ur5e"}, "PickCube (robot=ur5e)"),
        ({"simulator": "sapien", "renderer": "gl"}, "PickCube (simulator=sapien, renderer=gl)"),
        ({"image_size": 32}, "PickCube"),
    ],
)
def test_the_title_names_what_is_not_usual_of_the_scene(
    evaluation: Evaluation, changes: dict[str, Any], scene: str
) -> None:
    env = evaluation.result.env.replace(**changes)
    moved = dataclasses.replace(evaluation, result=dataclasses.replace(evaluation.result, env=env))
    assert success_table(moved).title == f"{scene}, act, trained on level 0: success in 2 episodes"
    assert str(instruction_table(moved).title).startswith(f"{scene}, act: success in the task when")


def test_the_title_says_that_the_task_was_not_learned(evaluation: Evaluation) -> None:
    other = dataclasses.replace(evaluation.result, env=EnvSpec(task="StackCube"), train_tasks=("PickCube",))
    title = success_table(dataclasses.replace(evaluation, result=other)).title
    assert title == "StackCube, act, trained on PickCube at level 0, not on StackCube: success in 2 episodes"


def test_the_paths_of_everything_are_printed(evaluation: Evaluation) -> None:
    said = printed(evaluation_report([evaluation], BOARD))
    for path in (*BOARD.values(), evaluation.path, evaluation.videos[0]):
        assert str(path) in said
    assert "… and 1 more beside them" in said and "8.mp4" not in said


def test_report_has_the_expert_rate_and_times(evaluation: Evaluation) -> None:
    trained = TrainResult(
        checkpoint=Path("runs/x/checkpoints/last/pretrained_model"), steps=1234, loss=0.5, elapsed_s=60.0,
        samples_per_s=10.0, stopped_by="time_limit", precision="fp32", plot=Path("runs/x/losses.png"),
    )  # fmt: skip
    stages = {"collect": {"seconds": 5.0}, "train": {"seconds": 61.0}}
    run = TrainedRun(
        folder=Path("runs/x"), dataset=SUMMARY, trained=trained, evaluations=(evaluation,), board=BOARD,
        stages=stages, seconds=3671, gif=Path("runs/x/policy.gif"),
    )  # fmt: skip
    said = printed(train_report(run))
    assert "Collected 9 demonstrations; the expert succeeded in 90.0 % of 10 episodes." in said
    assert "Trained 1,234 steps (stopped by time limit), loss 0.5000." in said
    assert "Done in 1:01:11: collect 0:05, train 1:01." in said
    assert "runs/x/losses.png" in said
    policy, page = [line.split() for line in said.splitlines() if line.strip()][-2:]
    assert policy == ["See", "the", "policy", "runs/x/policy.gif"]
    assert page == ["Open", "in", "a", "browser", "results/leaderboard.html"]


@pytest.mark.parametrize(
    ("damaged", "content", "wrong"),
    [
        ("v2/cut.json", '{"schema_version": 3', "is not a whole JSON file"),
        ("v2/later.json", '{"schema_version": 9, "cells": [], "records": []}', "has schema version 9"),
        ("v2/notes.json", "{}", "is not a results file"),
        ("suites/paper/act/cut.json", "{", "is no result of a suite"),
        ("calvin_chains.json", "{", "has no results of chains"),
    ],
)
def test_a_run_whose_leaderboard_cannot_be_written_is_complete_with_a_warning(
    damaged: str,
    content: str,
    wrong: str,
    evaluation: Evaluation,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    file = Path("results", damaged)
    file.parent.mkdir(parents=True)
    file.write_text(content)
    with RunFolder.open(compose("train", ["policy=act", "device=cpu"]), ["roboverse", "train"]) as opened:
        shown = command._show(opened.config, opened, [dataclasses.replace(evaluation, videos=())])
        assert opened.stages["leaderboard"]["status"] == "stopped"
    trained = TrainResult(
        checkpoint=Path("runs/x/last"), steps=1234, loss=0.5, elapsed_s=60.0, samples_per_s=10.0,
        stopped_by="steps", precision="fp32", plot=None,
    )  # fmt: skip
    run = TrainedRun(
        folder=Path("runs/x"), dataset=SUMMARY, trained=trained, evaluations=(evaluation,), stages={},
        seconds=60.0, **shown,
    )  # fmt: skip
    monkeypatch.setattr(command, "train_run", lambda config: run)
    assert cli.main(["train", "policy=act"]) == 0, "else a sweep counts every run as failed"
    said = capsys.readouterr()
    for words in ("PickCube, act, trained on", str(run.folder), "runs/x/last", str(evaluation.path)):
        assert words in said.out
    warning, *_, after = said.err[said.err.index("warning: ") :].splitlines()
    assert ("No leaderboard was written" in warning) is (file.parent.name == "v2")
    assert f"{file}" in said.err and wrong in said.err and "error:" not in said.err
    assert after.endswith(
        "without a leaderboard. Mend the above, then run: roboverse leaderboard results_dir=results"
    )
    assert cli.main(["leaderboard"]) == 2
    assert wrong in capsys.readouterr().err
    file.unlink()
    assert (
        cli.main(after.split("run: roboverse ")[1].split()) == 0 and Path("results/leaderboard.md").is_file()
    )


def test_the_report_of_a_collection() -> None:
    said = printed(collection_report(SUMMARY))
    assert "900 frames, 1:01, hash ffffffffffffffff." in said and "datasets/x" in said

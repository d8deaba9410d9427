"""The last line of a report: the page that the new result is on."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.protocol import Protocol
from benchmark.records import Checkpoint, EpisodeRecord, Machine, Result
from benchmark.results import result_path, write_result
from envs.spec import EnvSpec
from roboverse_learn import cli
from roboverse_learn.commands.outcomes import Evaluation, TrainedRun
from roboverse_learn.commands.report import evaluation_report, train_report
from roboverse_learn.leaderboard import write_leaderboard_of
from roboverse_learn.training.reporter import TrainResult

RECORD = EpisodeRecord(
    task="PickCube", policy="act", level=0, channels=("task",), split="test", episode=1, seed=0,
    initial_state_hash="0123456789abcdef", success=True, length=9, episode_return=1.5, wall_time_s=0.25,
    simulator="mujoco", renderer="warp",
)  # fmt: skip
STUDY = Result(
    run="r", created="2026-01-01T00:00:00Z", protocol=Protocol(levels=(0,), splits=("test",), episodes=1),
    env=EnvSpec(image_size=64), max_episode_steps=100, control_hz=20.0, policy="act", train_level=0, seed=0,
    dataset_hash="d" * 64, checkpoint=Checkpoint(step=1, hash="c" * 64), demonstrations=9, git=None,
    command="python roboverse_learn/train.py", machine=Machine(device="cpu", cpu_count=2), records=(RECORD,),
)  # fmt: skip
ENTRY = replace(STUDY, run="e", recipe="act_v1")


def published(results: Path, *given: Result) -> list[Evaluation]:
    """Writes results; returns their evaluations."""
    for result in given:
        write_result(result_path(results, result), result)
    return [Evaluation(path=result_path(results, result), result=result, videos=()) for result in given]


@pytest.mark.parametrize(
    ("given", "pages"),
    [
        ([STUDY], ["studies.html"]),
        ([ENTRY], ["leaderboard.html"]),
        ([STUDY, ENTRY], ["leaderboard.html", "studies.html"]),
    ],
)
def test_the_report_ends_with_the_page_that_the_new_result_is_on(
    given: list[Result], pages: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    published(tmp_path, *({"r": ENTRY, "e": STUDY}[one.run] for one in given[:1]))  # of earlier runs
    evaluations = published(tmp_path, *given)
    board = write_leaderboard_of(tmp_path, evaluations)
    trained = TrainResult(
        checkpoint=Path("runs/x/last"), steps=10, loss=0.5, elapsed_s=60.0, samples_per_s=10.0,
        stopped_by="steps", precision="fp32", plot=None,
    )  # fmt: skip
    run = TrainedRun(
        folder=Path("runs/x"), dataset=None, trained=trained, evaluations=tuple(evaluations), board=board,
        stages={}, seconds=60.0,
    )  # fmt: skip
    for report in (train_report(run), evaluation_report(evaluations, board)):
        cli._show(report)
        last = [line for line in capsys.readouterr().out.splitlines() if line.strip()][-len(pages) :]
        assert last[0].startswith("Open in a browser  ")
        assert [line.split()[-1] for line in last] == [str(tmp_path / page) for page in pages]


@pytest.mark.slow
def test_the_report_of_a_baseline_ends_with_the_board(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["levels=[0]", "splits=[test]", "episodes=1", "videos=0", f"results_dir={tmp_path}"]
    assert cli.main(["evaluate", "policy=random", "task=PickCube", *words]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("Open in a browser")]
    assert line.split()[-1] == str(tmp_path / "leaderboard.html")

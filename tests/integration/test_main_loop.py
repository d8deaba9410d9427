"""The whole loop on real physics and real pixels, as small as it gets, through the command line."""

import json
import shutil
from pathlib import Path

import pytest

from benchmark.result_file import read_result
from policies.checkpoint import WEIGHTS
from roboverse_learn import cli
from roboverse_learn.run import read_config, read_facts

pytestmark = pytest.mark.slow

TINY = [
    *("policy=act", "task=PickCube", "preset=quick", "image_size=32", "device=cpu"),
    *("num_demos=2", "collect.num_workers=1", "collect.num_envs=2"),
    *("train.steps=3", "batch_size=2", "save_every=2", "log_every=1", "train.num_threads=1"),
    *("policy.dim_model=32", "policy.dim_feedforward=32", "policy.n_heads=2", "policy.chunk_size=50"),
    *("policy.n_action_steps=50", "levels=[0,3]", "splits=[test]", "episodes=1", "evaluate.num_envs=1"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs the main command once; returns the folder that it ran in."""
    folder = tmp_path_factory.mktemp("loop")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert cli.main(["train", *TINY]) == 0
    return folder


@pytest.fixture
def run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Returns the run's folder, from the folder of the command."""
    monkeypatch.chdir(folder)
    (run,) = Path("runs/PickCube/act").iterdir()
    return run


def test_the_loop_leaves_behind_all_that_it_promises(run: Path) -> None:
    result = read_result(Path("results/v1/PickCube/act") / f"{run.name}.json")
    assert [str(cell.cell) for cell in result.cells()] == ["level 0, test split", "level 3, test split"]
    assert result.cells()[1].channels == ("task", "environment", "camera", "lighting")
    assert (result.train_level, result.demonstrations, result.checkpoint.step) == (0, 2, 3)
    assert result.dataset_hash == read_facts(run, "collect")["dataset_hash"]
    assert result.config["train"]["steps"] == 3
    assert {record.initial_state_hash for record in result.records} != {""}
    for path in ("leaderboard.json", "leaderboard.md", "leaderboard.html"):
        assert (Path("results") / path).stat().st_size > 0
    assert list(Path("results/plots").glob("*.png"))
    videos = list((Path("results/v1/PickCube/act") / run.name).glob("*.mp4"))
    assert {video.name.split("-")[0] for video in videos} == {"level0", "level3"}
    assert (run / "losses.png").exists()
    assert [
        facts["status"] for facts in json.loads((run / "manifest.json").read_text())["stages"].values()
    ] == ["done"] * 4


def test_the_same_command_again_repeats_nothing(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [
        Path("results/v1/PickCube/act") / f"{run.name}.json",
        run / "checkpoints/last/pretrained_model" / WEIGHTS,
    ]
    before = [path.stat().st_mtime_ns for path in paths]
    assert cli.main(["train", *TINY]) == 0
    assert [path.stat().st_mtime_ns for path in paths] == before
    assert "level 3" in capsys.readouterr().out


def test_a_checkpoint_is_evaluated_alone(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["levels=[]", "alone=[camera]", "splits=[test]", "episodes=1", "videos=0", "device=cpu"]
    assert cli.main(["evaluate", f"checkpoint={run}", *words]) == 0
    assert "camera alone" in capsys.readouterr().out
    (path,) = set(Path("results/v1/PickCube/act").glob("*.json")) - {
        Path("results/v1/PickCube/act") / f"{run.name}.json"
    }
    result = read_result(path)
    assert result.run.startswith(run.name) and result.image_size == read_config(run).image_size == 32
    assert result.cells()[0].channels == ("task", "camera")
    assert cli.main(["leaderboard"]) == 0
    path.unlink()


def test_a_broken_checkpoint_is_one_message(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(run / "checkpoints/last/pretrained_model", copy)
    content = (copy / WEIGHTS).read_bytes()
    (copy / WEIGHTS).write_bytes(content[: len(content) // 2])
    results = tmp_path / "results"
    assert (
        cli.main(["evaluate", f"checkpoint={copy}", "task=PickCube", f"results_dir={results}", "device=cpu"])
        == 2
    )
    said = capsys.readouterr().err
    assert "truncated" in said and "Traceback" not in said
    assert not results.exists()


def test_a_checkpoint_of_nobody_needs_a_task(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(run / "checkpoints/last/pretrained_model", copy)
    assert cli.main(["evaluate", f"checkpoint={copy}"]) == 2
    assert "lies in no run of ours" in capsys.readouterr().err


def test_a_truncated_dataset_is_one_message(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = Path(read_facts(run, "collect")["folder"])
    copy = tmp_path / "dataset"
    shutil.copytree(source, copy)
    video = next(copy.rglob("*.mp4"))
    video.write_bytes(video.read_bytes()[:1000])
    words = [f"dataset={copy}", f"runs_dir={tmp_path / 'runs'}", f"results_dir={tmp_path / 'results'}"]
    assert cli.main(["train", *TINY, *words]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert not (tmp_path / "results").exists()


def test_results_of_another_schema_stop_the_leaderboard(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "v1/PickCube/act/old.json"
    path.parent.mkdir(parents=True)
    path.write_text('{"schema_version": 99}')
    assert cli.main(["leaderboard", f"results_dir={tmp_path}"]) == 2
    assert "schema version 99" in capsys.readouterr().err
    assert not (tmp_path / "leaderboard.json").exists()

"""The whole loop on real physics and real pixels, as small as it gets, through the command line."""

import json
import re
import shutil
from pathlib import Path

import pytest
from PIL import Image

from benchmark.results import read_result
from envs.core.errors import MissingExtraError
from envs.simulators import HANDLERS
from policies.checkpoint import WEIGHTS
from roboverse_learn import cli
from roboverse_learn.commands.run_folder import read_config, read_facts
from tests.integration.main_run import TINY, MainRun

pytestmark = pytest.mark.slow


@pytest.fixture
def run(main_run: MainRun, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Returns the run's folder, from the folder of the command."""
    monkeypatch.chdir(main_run.folder)
    return main_run.run


def test_the_loop_leaves_behind_all_that_it_promises(run: Path) -> None:
    result = read_result(Path("results/v2/PickCube/act") / f"{run.name}.json")
    assert [str(cell.cell) for cell in result.cells()] == ["level 0, test split", "level 3, test split"]
    assert result.cells()[1].channels == ("task", "environment", "camera", "lighting")
    assert (result.train_level, result.demonstrations, result.checkpoint.step) == (0, 4, 12)
    assert result.dataset_hash == read_facts(run, "collect")["dataset_hash"]
    assert result.config["train"]["steps"] == 12
    assert {record.initial_state_hash for record in result.records} != {""}
    for path in ("leaderboard.json", "leaderboard.md", "leaderboard.html", "studies.md", "studies.html"):
        assert (Path("results") / path).stat().st_size > 0
    assert list(Path("results/plots").glob("*.png"))
    videos = list((Path("results/v2/PickCube/act") / run.name).glob("*.mp4"))
    assert {video.name.split("-")[0] for video in videos} == {"level0", "level3"}
    assert (run / "losses.png").exists() and (run / "policy.gif").exists()
    assert [
        facts["status"] for facts in json.loads((run / "manifest.json").read_text())["stages"].values()
    ] == ["done"] * 4


@pytest.mark.parametrize("stage", ["collecting", "training", "evaluating"])
def test_the_log_has_lines_of_each_stage_with_count_rate_and_time_left(run: Path, stage: str) -> None:
    line = re.compile(
        stage + r" [\d,]+/[\d,]+ \(\d+ %\), .*/s, \d+:\d\d left, \d+:\d\d elapsed$", re.MULTILINE
    )
    assert line.search((run / "run.log").read_text())


def test_the_same_command_again_repeats_nothing(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [
        Path("results/v2/PickCube/act") / f"{run.name}.json",
        run / "checkpoints/last/pretrained_model" / WEIGHTS,
    ]
    before = [path.stat().st_mtime_ns for path in paths]
    assert cli.main(["train", *TINY]) == 0
    assert [path.stat().st_mtime_ns for path in paths] == before
    said = capsys.readouterr().out
    assert "level 3" in said
    last = "".join(said.split())  # a long path is folded
    assert last.endswith(  # a run of so few demonstrations is a study
        f"Seethepolicy{run}/policy.gifOpeninabrowserresults/studies.html".replace(f"{Path.cwd()}/", "")
    )


def test_a_dry_run_says_that_all_is_there(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def times() -> dict[Path, int]:
        return {path: path.stat().st_mtime_ns for path in Path().rglob("*") if path.is_file()}

    before = times()
    assert cli.main(["train", *TINY, "dry_run=true"]) == 0
    _, shown, collect, *_ = capsys.readouterr().out.splitlines()
    assert f"{run.relative_to(Path().resolve())} (done, 12 of 12 steps, " in shown
    assert collect.endswith("(4 of 4 are there)")
    assert times() == before


def test_a_checkpoint_is_evaluated_alone(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["levels=[]", "alone=[camera]", "splits=[test]", "episodes=1", "videos=0", "device=cpu"]
    assert cli.main(["evaluate", f"checkpoint={run}", *words]) == 0
    assert "camera alone" in capsys.readouterr().out
    (path,) = set(Path("results/v2/PickCube/act").glob("*.json")) - {
        Path("results/v2/PickCube/act") / f"{run.name}.json"
    }
    result = read_result(path)
    assert result.run.startswith(run.name) and result.env.image_size == read_config(run).env.image_size == 32
    assert result.cells()[0].channels == ("task", "camera")
    assert cli.main(["leaderboard"]) == 0
    path.unlink()


def test_a_checkpoint_is_evaluated_in_a_changed_scene_on_other_materials(run: Path, tmp_path: Path) -> None:
    for number in range(3):
        Image.new("RGB", (16, 16), (80 * number, 200, 10)).save(tmp_path / f"{number}.png")
    words = ["levels=1", "splits=test", "episodes=1", "videos=0", "device=cpu", f"materials=+{tmp_path}"]
    scene = ["scenario.physics.decimation=50", "scenario.cameras.front.fovy_deg=60"]
    assert cli.main(["evaluate", f"checkpoint={run}", *words, *scene]) == 0
    folder = Path("results/v2/PickCube/act")
    (path,) = set(folder.glob("*.json")) - {folder / f"{run.name}.json"}
    result = read_result(path)
    assert result.env.scenario == {"physics": {"decimation": 50}, "cameras": {"front": {"fovy_deg": 60}}}
    assert result.control_hz == 10.0
    assert result.env.materials.startswith(f"+{tmp_path.name}-")
    before = path.stat().st_mtime_ns
    assert cli.main(["evaluate", f"checkpoint={run}", *words, *scene]) == 0
    assert path.stat().st_mtime_ns == before  # it was not evaluated again
    path.unlink()


@pytest.mark.parametrize("simulator", ["sapien", "pybullet"])
def test_a_checkpoint_is_evaluated_in_another_simulator(run: Path, simulator: str) -> None:
    try:
        HANDLERS.get(simulator)
    except MissingExtraError as error:
        pytest.skip(str(error))
    words = ["levels=[0]", "splits=[test]", "episodes=1", "videos=0", "device=cpu", "renderer=warp"]
    assert cli.main(["evaluate", f"checkpoint={run}", f"simulator={simulator}", *words]) == 0
    folder = Path("results/v2/PickCube/act")
    (path,) = set(folder.glob("*.json")) - {folder / f"{run.name}.json"}
    result, trained = read_result(path), read_result(folder / f"{run.name}.json")
    assert (result.env.simulator, trained.env.simulator) == (simulator, "mujoco")
    assert result.checkpoint == trained.checkpoint
    assert cli.main(["leaderboard"]) == 0
    assert simulator in Path("results/studies.md").read_text()
    path.unlink()


def test_checkpoint_without_a_run_needs_a_task(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(run / "checkpoints/last/pretrained_model", copy)
    assert cli.main(["evaluate", f"checkpoint={copy}"]) == 2
    assert "is in no run folder" in capsys.readouterr().err

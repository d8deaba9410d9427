"""One success and one failure per entry and level stay; the folder of results stays small."""

import shutil
import subprocess
from dataclasses import asdict
from pathlib import Path

import pytest

from benchmark.leaderboard import build as leaderboard
from benchmark.leaderboard.section_plots import draw_sections
from benchmark.leaderboard.video_rule import KEEP_FILE, kept_videos, named_videos, remove_other_videos
from benchmark.results import ResultError, video_dir
from roboverse_learn.training.config import TrainConfig

ROOT = Path(__file__).parents[3]


@pytest.fixture
def filmed(publish, tmp_path):
    """A function that publishes a result with videos of the given names."""

    def make(*names, **result):
        folder = video_dir(publish(**result))
        folder.mkdir()
        for name in names:
            (folder / f"{name}.mp4").touch()
            (folder / f"{name}.png").touch()
        return folder.relative_to(tmp_path).as_posix()

    return make


def test_the_first_success_and_failure_of_each_shown_cell_stay(filmed, tmp_path):
    own = filmed(
        *("level0-test-9001-success", "level0-test-9002-success", "level0-test-9003-failure"),
        *("level2-test-9001-failure", "level0-train-1-success", "camera-test-9001-failure"),
    )
    filmed("level0-test-9001-success", run="seed", seed=1)
    there = filmed("level3-test-9001-success", "level0-test-9001-success", run="there", train_level=3)
    filmed("level0-test-9001-success", run="study", recipe="")
    assert kept_videos(leaderboard.build(tmp_path)) == {
        f"{own}/level0-test-9001-success.mp4",
        f"{own}/level0-test-9003-failure.mp4",
        f"{own}/level2-test-9001-failure.mp4",
        f"{there}/level3-test-9001-success.mp4",
    }


def test_videos_of_a_preset_go_where_a_recipe_of_its_policy_has_some_of_the_task(filmed, tmp_path):
    preset = {
        "recipe": "",
        "config": {"preset": "quick", "policy": {}, "train": {}},
        "command": "python roboverse_learn/train.py policy=act preset=quick",
    }
    cube = filmed("level0-test-9001-success", run="preset", **preset)
    box = filmed("level0-test-9001-success", run="preset", task="CloseBox", **preset)
    assert {path.rpartition("/")[0] for path in kept_videos(leaderboard.build(tmp_path))} == {cube, box}
    filmed()  # a run of the recipe without videos
    assert {path.rpartition("/")[0] for path in kept_videos(leaderboard.build(tmp_path))} == {cube, box}
    recipe = filmed("level0-test-9001-success", run="again", seed=1)
    assert {path.rpartition("/")[0] for path in kept_videos(leaderboard.build(tmp_path))} == {recipe, box}


def test_other_videos_are_removed_with_their_posters(filmed, tmp_path):
    filmed("level0-test-9001-success")
    study = filmed("level0-test-9001-success", run="study", recipe="")
    (tmp_path / "mine.mp4").touch()
    removed = remove_other_videos(tmp_path, leaderboard.build(tmp_path))
    assert removed == [tmp_path / study / "level0-test-9001-success.mp4"]
    assert not (tmp_path / study).exists() and (tmp_path / "mine.mp4").exists()
    assert len(list(tmp_path.rglob("level0-test-9001-success.*"))) == 2
    assert remove_other_videos(tmp_path, leaderboard.build(tmp_path)) == []


def test_videos_that_the_keep_file_names_stay(filmed, tmp_path):
    study = filmed("level0-test-9001-success", "level0-test-9002-failure", run="study", recipe="")
    shown = f"{study}/level0-test-9001-success.mp4"
    (tmp_path / KEEP_FILE).write_text(f"# of the front page\n{shown}  # the first\n\n")
    removed = remove_other_videos(tmp_path, leaderboard.build(tmp_path))
    assert [path.name for path in removed] == ["level0-test-9002-failure.mp4"]
    assert (tmp_path / shown).exists() and (tmp_path / shown).with_suffix(".png").exists()


def test_a_keep_file_with_a_video_that_is_not_there_removes_nothing(filmed, tmp_path):
    study = filmed("level0-test-9001-success", run="study", recipe="")
    (tmp_path / KEEP_FILE).write_text("v2/gone.mp4\n")
    with pytest.raises(ResultError, match=r"names videos that are not there: v2/gone\.mp4"):
        remove_other_videos(tmp_path, leaderboard.build(tmp_path))
    assert (tmp_path / study / "level0-test-9001-success.mp4").exists()


@pytest.fixture(scope="module")
def published():
    """The leaderboard of this repository's results."""
    git = ["git", "-C", str(ROOT), "ls-files", "--others", "--exclude-standard", "results/v2"]
    own = subprocess.run(git, capture_output=True, text=True, check=False)
    if own.returncode == 0 and own.stdout:
        pytest.skip("the folder has runs of one's own")
    return leaderboard.build(ROOT / "results", asdict(TrainConfig()))


@pytest.mark.slow
def test_the_videos_of_this_repository_are_those_of_the_rule(published):
    results = ROOT / "results"
    kept = kept_videos(published) | named_videos(results)
    there = {path.relative_to(results).as_posix() for path in results.rglob("*.mp4")}
    assert there == kept


@pytest.mark.slow
def test_a_clone_renders_no_plot_of_this_repository_again(published, tmp_path):
    plots = shutil.copytree(ROOT / "results/plots", tmp_path / "plots")
    before = {path.name: path.stat().st_mtime_ns for path in plots.iterdir()}
    drawn = draw_sections(tmp_path, published)
    assert {path.name for path in drawn.values()} == set(before)
    rendered = [path.name for path in plots.iterdir() if path.stat().st_mtime_ns != before[path.name]]
    assert not rendered, "run roboverse leaderboard, and commit all of results/plots"


def test_the_results_of_this_repository_are_below_45_megabytes():
    size = sum(path.stat().st_size for path in (ROOT / "results").rglob("*") if path.is_file())
    assert size < 45e6, "run roboverse leaderboard prune_videos=true"

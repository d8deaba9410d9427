"""The GIF of a policy: which episodes it shows, and how."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmark.gifs import TILE_PX, usual_of_each_level, write_gif
from benchmark.protocol import Cell
from benchmark.records import CellSummary
from benchmark.videos import write_video


def video(path: Path, length: int, grey: int) -> Path:
    frames = np.full((length, 32, 32, 3), grey, np.uint8)
    frames[:, :4, :4] = 25 * np.arange(length)[:, None, None, None]  # equal frames would become one
    write_video(path, frames, fps=10.0)
    return path


def test_videos_are_side_by_side_and_the_shorter_one_holds_its_last_frame(tmp_path: Path) -> None:
    videos = [
        video(tmp_path / "level0-test-3-success.mp4", 2, 200),
        video(tmp_path / "level3-test-5-failure.mp4", 5, 50),
    ]
    path = write_gif(tmp_path / "policy.gif", videos)
    assert path is not None
    with Image.open(path) as image:
        assert image.size == (2 * TILE_PX, TILE_PX) and image.info["duration"] == 100
        assert image.info["loop"] == 0
        image.seek(image.n_frames - 1)
        last = np.asarray(image.convert("RGB")).astype(int)
    success, failure = last[1, 1], last[1, TILE_PX + 1]
    assert success[1] > success[0] and failure[0] > failure[1]  # green and red
    middle = TILE_PX // 2
    assert abs(last[middle, middle] - 200).max() < 12
    assert abs(last[middle, TILE_PX + middle] - 50).max() < 12


def test_without_videos_there_is_no_gif(tmp_path: Path) -> None:
    assert write_gif(tmp_path / "policy.gif", []) is None
    assert not list(tmp_path.iterdir())


def cell(level: int, successes: int) -> CellSummary:
    return CellSummary(
        cell=Cell(level=level, split="test"), channels=(), not_shown=(), episodes=10, successes=successes,
        success_rate=successes / 10, ci_low=0.0, ci_high=1.0, mean_length=5.0, mean_return=successes / 10,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("successes", "shown"), [(0, "7-failure"), (1, "7-failure"), (4, "7-failure"), (5, "9-success")]
)
def test_video_of_a_level_is_of_what_happens_more_often(successes: int, shown: str) -> None:
    names = ("level1-test-9-success", "level1-test-8-failure", "level1-test-7-failure")
    chosen = usual_of_each_level([Path(f"{name}.mp4") for name in names], [cell(1, successes)])
    assert [path.stem for path in chosen] == [f"level1-test-{shown}"]


def test_video_of_the_other_outcome_stands_where_the_usual_one_was_not_filmed() -> None:
    chosen = usual_of_each_level([Path("level1-test-8-failure.mp4")], [cell(1, 10)])
    assert [path.stem for path in chosen] == ["level1-test-8-failure"]


def test_videos_are_sorted_by_level_and_those_of_other_evaluations_left_out() -> None:
    names = ("level3-test-1-success", "level0-test-2-success", "level2-test-3-success")
    chosen = usual_of_each_level([Path(f"{name}.mp4") for name in names], [cell(3, 9), cell(0, 9)])
    assert [path.stem for path in chosen] == ["level0-test-2-success", "level3-test-1-success"]

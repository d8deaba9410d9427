"""The GIF of a policy: which episodes it shows, and how."""

from pathlib import Path

import numpy as np
from PIL import Image

from benchmark.gifs import TILE_PX, one_per_level, write_gif
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


def test_video_of_a_level_prefers_a_success() -> None:
    names = (
        "level1-test-9-failure",
        "level0-test-44-failure",
        "level0-test-9-success",
        "level1-test-8-failure",
    )
    chosen = one_per_level([Path(f"{name}.mp4") for name in names])
    assert [path.stem for path in chosen] == ["level0-test-9-success", "level1-test-8-failure"]

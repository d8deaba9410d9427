"""One GIF of a policy, from the videos of its evaluation."""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

from benchmark.records import CellSummary
from envs.core.atomic import atomic_path

TILE_PX = 160
"""Height and width of each episode in the GIF, pixels."""

BORDER_PX = 3

MAX_FRAMES = 60
"""Longer episodes are shown with every second frame, or fewer, at the same speed."""

_GREEN, _RED = (40, 160, 80), (200, 60, 50)


def write_gif(path: Path, videos: Sequence[Path]) -> Path | None:
    """Puts videos side by side into one animated GIF, with a green border where the episode succeeded.

    An episode that ends before the longest one stays at its last frame.

    Args:
        path: The ``.gif`` file.
        videos: Videos of :func:`benchmark.videos.film_cell`, from the left.

    Returns:
        ``path``, or None if there is no video.

    Raises:
        WriteError: The file cannot be written.
    """
    from PIL import Image

    if not videos:
        return None
    tiles = [_tiles(video) for video in videos]
    rate = tiles[0][1]
    length = max(len(frames) for frames, _ in tiles)
    every = -(-length // MAX_FRAMES)
    images = [
        Image.fromarray(np.hstack([frames[min(step, len(frames) - 1)] for frames, _ in tiles]))
        for step in [*range(0, length - 1, every), length - 1]
    ]
    with atomic_path(path, keep_suffix=True) as temporary:
        images[0].save(
            temporary,
            format="GIF",
            save_all=True,
            append_images=images[1:],
            loop=0,
            duration=1000 * every / rate,
        )
    return path


def usual_of_each_level(videos: Sequence[Path], cells: Sequence[CellSummary]) -> list[Path]:
    """Returns one video of each cell, sorted by cell: of what happens more often there; success where equal.

    Args:
        videos: Videos of :func:`benchmark.videos.film_cell`. Those of other cells are left out.
        cells: The cells of the evaluation.
    """
    chosen: list[Path] = []
    for cell in sorted(cells, key=lambda cell: cell.cell.name):
        own = sorted(video for video in videos if video.stem.rsplit("-", 2)[0] == cell.cell.name)
        usual = "success" if cell.success_rate >= 0.5 else "failure"
        own.sort(key=lambda video: not video.stem.endswith(usual))  # the sort is stable
        chosen += own[:1]
    return chosen


def _tiles(video: Path) -> tuple[list[np.ndarray], float]:
    """Returns a video as bordered tiles (TILE_PX, TILE_PX, 3) uint8, and its frames per second."""
    import av
    import cv2

    inner = TILE_PX - 2 * BORDER_PX
    colour = _GREEN if video.stem.endswith("success") else _RED
    with closing(av.open(str(video))) as container:
        rate = float(container.streams.video[0].average_rate or 10)
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    tiles = []
    for frame in frames:
        tile = np.full((TILE_PX, TILE_PX, 3), colour, np.uint8)
        resized = cv2.resize(frame, (inner, inner), interpolation=cv2.INTER_CUBIC)
        tile[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = resized
        tiles.append(tile)
    return tiles, rate

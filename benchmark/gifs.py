"""One GIF of a policy, from the videos of its evaluation."""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

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


def one_per_level(videos: Sequence[Path]) -> list[Path]:
    """Returns the first success of each cell, or its first failure where it has none; sorted by cell."""
    chosen: dict[str, Path] = {}
    for video in sorted(videos):
        cell, _, outcome = video.stem.rsplit("-", 2)
        if cell not in chosen or (outcome == "success" and not chosen[cell].stem.endswith("success")):
            chosen[cell] = video
    return [chosen[cell] for cell in sorted(chosen)]


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

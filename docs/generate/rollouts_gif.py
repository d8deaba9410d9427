"""The GIF of rollouts: one success of a policy in each task, from the videos of results.

``python -m docs.generate.rollouts_gif`` writes ``docs/rollouts.gif``.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, ImageSequence

from benchmark.gifs import write_gif
from envs.core.arguments import run_program
from envs.core.atomic import atomic_path
from envs.core.errors import ConfigError

COLOURS = 64


@dataclass(frozen=True, kw_only=True, slots=True)
class GifSettings:
    """Writes the GIF of rollouts.

    Attributes:
        out: The GIF.
        results_dir: Folder of results.
        policy: Policy.
        tasks: Tasks, from the left.
        level: Level that the policy was trained and tested at.
    """

    out: Path = Path("docs/rollouts.gif")
    results_dir: Path = Path("results")
    policy: str = "diffusion"
    tasks: tuple[str, ...] = ("PickCube", "StackCube", "CloseBox", "MoveSliderLeft", "PickChocolatePudding")
    level: int = 3


def videos(settings: GifSettings) -> list[Path]:
    """Returns the first video of a success of each task.

    Raises:
        ConfigError: A task has none.
    """
    found = []
    for task in settings.tasks:
        runs = f"*/{task}/{settings.policy}/*-level{settings.level}-*"
        videos_of = sorted(
            settings.results_dir.glob(f"{runs}/level{settings.level}-test-*-success.mp4"),
            key=lambda path: path.as_posix(),
        )
        if not videos_of:
            raise ConfigError(
                f"{settings.results_dir} has no video of a success of {settings.policy} in {task} at level "
                f"{settings.level}. Evaluate it there with videos=1, or name other tasks=[…]."
            )
        found.append(videos_of[0])
    return found


def reduce(path: Path) -> None:
    """Keeps every second frame of a GIF and one palette for all: a sixth of the bytes."""
    with Image.open(path) as gif:
        frames = [frame.convert("RGB") for frame in ImageSequence.Iterator(gif)][::2]
        duration_ms = 2 * gif.info["duration"]
    save_gif(path, frames, duration_ms)


def save_gif(path: Path, frames: Sequence[Image.Image], duration_ms: float) -> None:
    """Writes images of one size as a GIF of few colours, with one palette for all.

    Args:
        path: The GIF.
        frames: The images.
        duration_ms: How long each is shown.
    """
    width, height = frames[0].size
    shown = Image.new("RGB", (width, 4 * height))
    for row in range(4):
        shown.paste(frames[row * len(frames) // 4], (0, row * height))
    palette = shown.quantize(COLOURS, dither=Image.Dither.NONE)
    first, *others = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    with atomic_path(path, keep_suffix=True) as temporary:
        first.save(temporary, format="GIF", save_all=True, append_images=others, loop=0, duration=duration_ms)


def main(words: Sequence[str] | None = None) -> int:
    """Writes the GIF; returns the exit code."""
    return run_program("python -m docs.generate.rollouts_gif", GifSettings, _write, words)


def _write(settings: GifSettings) -> None:
    write_gif(settings.out, videos(settings))
    reduce(settings.out)


if __name__ == "__main__":
    sys.exit(main())

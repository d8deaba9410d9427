"""The image of grasping by language: the three scenes that teach colours, and that of the unseen objects.

``python -m docs.generate.grasp_image`` writes ``docs/howto/grasp_by_language.jpg`` (extra ``libero``).
"""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from PIL import Image

from docs.generate.level_images import starts
from envs.core.arguments import NoSettings, run_program
from envs.spec import EnvSpec
from envs.tasks.grasp_language.catalogue import PREFIX, in_scene

OUT = Path("docs/howto/grasp_by_language.jpg")
SETS = ("colours_1", "colours_2", "colours_3", "unseen")
PIXELS, START = 256, 1


def scenes() -> Iterator[EnvSpec]:
    """Yields the environment of each scene."""
    for name in SETS:
        yield EnvSpec(task=f"{PREFIX}{name}/{in_scene(name)[0]}", cameras=("front",), image_size=PIXELS)


def main(words: Sequence[str] | None = None) -> int:
    """Writes the image; returns the exit code."""
    return run_program("python -m docs.generate.grasp_image", NoSettings, _draw, words)


def _draw(_: NoSettings) -> None:
    Image.fromarray(starts(scenes(), split="train", index=START)).save(OUT, quality=85)


if __name__ == "__main__":
    sys.exit(main())

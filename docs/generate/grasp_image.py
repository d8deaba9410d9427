"""The image of grasping by language: the three scenes that teach colours, and that of the unseen objects.

``python -m docs.generate.grasp_image`` writes ``docs/howto/grasp_by_language.jpg`` (extra ``libero``).
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from docs.generate.level_images import first_image
from envs.core.arguments import NoSettings, run_program
from envs.spec import EnvSpec
from envs.tasks.grasp_language.catalogue import PREFIX, in_scene

OUT = Path("docs/howto/grasp_by_language.jpg")
SETS = ("colours_1", "colours_2", "colours_3", "unseen")
PIXELS, START = 256, 1


def scenes() -> np.ndarray:
    """Returns a start in each scene, side by side, (H, W, 3) uint8."""
    images = []
    for name in SETS:
        spec = EnvSpec(task=f"{PREFIX}{name}/{in_scene(name)[0]}", cameras=("front",), image_size=PIXELS)
        env = spec.make(1, split="train")
        images.append(first_image(env, int(env.split_indices[START])))
        env.close()
    return np.hstack(images)


def main(words: Sequence[str] | None = None) -> int:
    """Writes the image; returns the exit code."""
    return run_program("python -m docs.generate.grasp_image", NoSettings, _draw, words)


def _draw(_: NoSettings) -> None:
    Image.fromarray(scenes()).save(OUT, quality=85)


if __name__ == "__main__":
    sys.exit(main())

"""The image of LIBERO: of each of its scenes, how a task begins and how the expert ends it.

``python -m docs.generate.libero_image`` writes ``docs/howto/libero.jpg``; the extra ``libero`` is needed. It
shows a scene's first task of those that count (:mod:`docs.generate.libero_page`). ``words=[libero/10]
out=ten.jpg`` draws all tasks that count and have these words.
"""

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from docs.generate.libero_page import BAR
from docs.generate.task_images import draw_strip
from envs.core.arguments import run_program
from envs.core.errors import ConfigError
from envs.experts.counts import read_counts
from envs.tasks.libero.catalogue import entries

logger = logging.getLogger(__name__)

PIXELS, COLUMNS = 128, 4
"""Side of each of the two images of a strip, and strips in a row."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ImageSettings:
    """Settings of the command.

    Attributes:
        words: Words that the names of the tasks have, all of them; one task of each scene without any.
        out: File of the image.
    """

    words: tuple[str, ...] = ()
    out: Path = Path("docs/howto/libero.jpg")


def shown(words: Sequence[str] = ()) -> list[str]:
    """Returns the tasks of an image, in LIBERO's order; see :class:`ImageSettings`.

    Raises:
        ConfigError: There is none.
    """
    counts, found = read_counts(), dict[str, str]()
    for name, entry in entries().items():
        counted = name in counts and counts[name].success_rate >= BAR
        if counted and all(word in name for word in words):
            found.setdefault(name if words else entry.scene_name, name)
    if not found:
        raise ConfigError(f"No task of LIBERO that counts has the words {' and '.join(words)} in its name.")
    return list(found.values())


def sheet(strips: Sequence[np.ndarray]) -> Image.Image:
    """Returns strips (H, 2 H, 3) in rows; what is left of the last row is white."""
    rows = -(-len(strips) // COLUMNS)
    whole = Image.new("RGB", (2 * PIXELS * COLUMNS, PIXELS * rows), "white")
    for place, strip in enumerate(strips):
        row, column = divmod(place, COLUMNS)
        whole.paste(Image.fromarray(strip).resize((2 * PIXELS, PIXELS)), (2 * PIXELS * column, PIXELS * row))
    return whole


def main(words: Sequence[str] | None = None) -> int:
    """Writes the image; returns the exit code."""
    return run_program("python -m docs.generate.libero_image", ImageSettings, _draw, words)


def _draw(settings: ImageSettings) -> None:
    strips = []
    for name in shown(settings.words):
        strips.append(draw_strip(name))
        logger.info("%d %s", len(strips), name)
    sheet(strips).save(settings.out, quality=85)


if __name__ == "__main__":
    sys.exit(main())

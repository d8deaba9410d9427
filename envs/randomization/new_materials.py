"""Writes materials that no split has as images: ``python -m envs.randomization.new_materials out=folder``.

A recipe is not chosen by the test split, and the materials of the validation split are those of training.
With ``evaluate.materials=folder`` the validation split shows how a policy does with materials new to it.
"""

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from envs.core.arguments import run_program
from envs.core.atomic import atomic_path
from envs.randomization import procedural
from envs.scenario import SURFACES

logger = logging.getLogger(__name__)

FIRST_NUMBER = 1_000
"""Number of a family's first new material; those of the splits are below it."""

SHARE = 5
"""One new material for so many of a family's own."""


@dataclass(frozen=True, kw_only=True, slots=True)
class NewMaterialsSettings:
    """Settings of the program.

    Attributes:
        out: The folder; images that it has are kept.
    """

    out: Path


def new_names(surface: int) -> list[str]:
    """Returns the new materials of surface 0 (table), 1 (wall) or 2 (ground), of each of its families."""
    names = []
    for family in procedural.FAMILIES.values():
        first = FIRST_NUMBER + sum(-(-count // SHARE) for count in family.counts[:surface])
        names += [f"{family.name}-{first + i}" for i in range(-(-family.counts[surface] // SHARE))]
    return names


def write_new_materials(out: Path) -> int:
    """Writes the images; returns how many there are."""
    from PIL import Image

    count = 0
    for surface, folder in enumerate(SURFACES):
        (out / folder).mkdir(parents=True, exist_ok=True)
        for name in new_names(surface):
            path = out / folder / f"{name}.png"
            if not path.exists():
                with atomic_path(path, keep_suffix=True) as partial:
                    Image.fromarray(procedural.texture(name)).save(partial)
            count += 1
    return count


def main(words: Sequence[str] | None = None) -> int:
    """Writes the folder; returns the exit code."""
    return run_program("python -m envs.randomization.new_materials", NewMaterialsSettings, _write, words)


def _write(settings: NewMaterialsSettings) -> None:
    logger.info("%s: %d materials that no split has", settings.out, write_new_materials(settings.out))


if __name__ == "__main__":
    sys.exit(main())

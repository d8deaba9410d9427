"""Sample images of the randomization levels.

``python -m docs.generate.level_images out=docs/levels.png`` renders every level with the environment;
``axes=docs/axes.png draws=6 image_size=160`` renders every channel that varies alone;
``materials=materials.png`` writes a contact sheet of the library, without any simulator.
"""

import logging
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from envs.core.arguments import run_program
from envs.core.atomic import atomic_path
from envs.core.errors import ConfigError
from envs.randomization.channels import CHANNELS
from envs.randomization.levels import LEVEL_CHANNELS, LEVELS
from envs.randomization.materials import MaterialLibrary
from envs.scenario import SURFACES
from envs.spec import EnvSpec

if TYPE_CHECKING:
    from PIL import Image

logger = logging.getLogger(__name__)

_GAP = 4
_CAPTION = 18


AXES = ("robot", "sensor", "layout", "environment", "camera", "lighting")
"""Channels that vary one at a time."""


def draw_levels(task: str, **options) -> "Image.Image":
    """Draws the first episodes of a split at every level, one level in a row; options as :func:`_drawn`."""
    captions = {level: f"Level {level}: {' + '.join(LEVEL_CHANNELS[: level + 1])}" for level in LEVELS}
    return _drawn(task, {caption: {"level": level} for level, caption in captions.items()}, **options)


def draw_axes(task: str, **options) -> "Image.Image":
    """Draws the first episodes of a split on every axis, one axis in a row; options as :func:`_drawn`."""
    captions = {axis: f"{axis}: {CHANNELS.entry(axis).summary}" for axis in AXES}
    return _drawn(task, {caption: {"only": axis} for axis, caption in captions.items()}, **options)


def _drawn(
    task: str,
    variations: dict[str, dict],
    *,
    split: str,
    num_draws: int,
    image_size: int,
    renderer: str,
) -> "Image.Image":
    """Draws one row of images for each variation.

    Args:
        task: Name of the task.
        variations: Caption to what varies, as options of the environment.
        split: ``"train"`` or ``"test"``.
        num_draws: Images in a row; the same episodes in every row.
        image_size: Pixels along an image's side.
        renderer: Name of the renderer.
    """
    import envs

    shared = {"split": split, "renderer": renderer, "image_size": image_size}
    rows = {}
    for caption, varied in variations.items():
        env = envs.make_vec(task, 1, **shared, **varied)
        try:
            rows[caption] = [first_image(env, int(episode)) for episode in env.split_indices[:num_draws]]
        finally:
            env.close()
    return contact_sheet(rows)


def first_image(env, episode: int) -> np.ndarray:
    """Returns what all cameras of one environment see as an episode starts, side by side, (H, W, 3)."""
    only = np.array([0])
    env.reset_envs(only, np.array([episode]))
    images = [v for key, v in env.observe(only).items() if key.startswith("observation.images.")]
    return np.concatenate([image[0] for image in images], axis=1)


def starts(specs: Iterable[EnvSpec], *, split: str, index: int) -> np.ndarray:
    """Returns how one episode of a split starts in each environment, side by side, (H, W, 3) uint8.

    Args:
        specs: The environments.
        split: ``"train"`` or ``"test"``.
        index: Which of the split's episodes.
    """
    images = []
    for spec in specs:
        env = spec.make(1, split=split)
        try:
            images.append(first_image(env, int(env.split_indices[index])))
        finally:
            env.close()
    return np.concatenate(images, axis=1)


def draw_materials(library: MaterialLibrary, *, per_row: int = 20, image_size: int = 64) -> "Image.Image":
    """Draws every material of a library, surface by surface.

    Args:
        library: The library.
        per_row: Materials in a row.
        image_size: Pixels along a material's side.
    """
    rows = {}
    for surface in SURFACES:
        names = library.names[surface]
        for start in range(0, len(names), per_row):
            caption = f"{surface}: {len(names)} materials" if start == 0 else ""
            rows[f"{caption}\0{surface}{start}"] = [
                library.texture(name, image_size) for name in names[start : start + per_row]
            ]
    return contact_sheet(rows)


def contact_sheet(rows: dict[str, list[np.ndarray]]) -> "Image.Image":
    """Lays images out in rows, each under its caption.

    Args:
        rows: Caption (up to a NUL, where two captions are alike) to (height, width, 3) uint8 images.
    """
    from PIL import Image, ImageDraw

    height, width = next(iter(rows.values()))[0].shape[:2]
    columns = max(len(images) for images in rows.values())
    captions = [caption.partition("\0")[0] for caption in rows]
    bands = [height + _GAP + (_CAPTION if caption else 0) for caption in captions]
    sheet = Image.new("RGB", (columns * (width + _GAP) + _GAP, sum(bands) + _GAP), "white")
    pen = ImageDraw.Draw(sheet)
    top = _GAP
    for caption, band, images in zip(captions, bands, rows.values(), strict=True):
        if caption:
            pen.text((_GAP, top), caption, fill="black", font_size=13)
        for column, image in enumerate(images):
            place = (_GAP + column * (width + _GAP), top + band - height - _GAP)
            sheet.paste(Image.fromarray(image), place)
        top += band
    return sheet


def save(image: "Image.Image", path: Path) -> None:
    """Writes an image under a temporary name and renames it.

    Raises:
        ConfigError: if the path's suffix is not that of an image format.
    """
    if path.suffix.lower() not in (".jpg", ".png", ".webp"):
        raise ConfigError(f"An image's name ends in .png, .jpg or .webp, given '{path}'.")
    with atomic_path(path, keep_suffix=True) as temporary:
        image.save(temporary)
    logger.info("%s: %d x %d pixels", path, *image.size)


@dataclass(frozen=True, kw_only=True, slots=True)
class GallerySettings:
    """Settings of the program.

    Attributes:
        out: Image of all levels.
        axes: Image of all axes.
        materials: Contact sheet of the library.
        folder: Folder of materials instead of the built-in ones.
        task: Name of a task.
        split: ``train`` or ``test``.
        renderer: Name of a renderer.
        draws: Images of each level.
        image_size: Pixels along an image's side.
    """

    out: Path | None = None
    axes: Path | None = None
    materials: Path | None = None
    folder: Path | None = None
    task: str = "PickCube"
    split: str = "train"
    renderer: str = "warp"
    draws: int = 8
    image_size: int = 256


def main(words: Sequence[str] | None = None) -> int:
    """Draws the levels, the library of materials, or both; returns the exit code."""
    return run_program("python -m docs.generate.level_images", GallerySettings, _draw_all, words)


def _draw_all(args: GallerySettings) -> None:
    if args.out is None and args.materials is None and args.axes is None:
        raise ConfigError(
            "There is nothing to render: give out=<file>, axes=<file>, materials=<file>, or several."
        )
    if args.materials is not None:
        library = MaterialLibrary.from_folder(args.folder) if args.folder else MaterialLibrary.built_in()
        save(draw_materials(library), args.materials)
    for path, draw in ((args.out, draw_levels), (args.axes, draw_axes)):
        if path is not None:
            image = draw(
                args.task,
                split=args.split,
                num_draws=args.draws,
                image_size=args.image_size,
                renderer=args.renderer,
            )
            save(image, path)


if __name__ == "__main__":
    sys.exit(main())

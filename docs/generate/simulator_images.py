"""Renders one scene with every installed renderer and simulator.

``python -m docs.generate.simulator_images out=docs/renderers.png`` renders the same states of the same
episodes, with physics of one simulator; what cannot run here is left out and named.
"""

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from docs.generate.level_images import contact_sheet, save
from envs.core.arguments import run_program
from envs.core.errors import MissingExtraError, SimulatorError
from envs.simulators import HANDLERS, RENDERERS

if TYPE_CHECKING:
    from PIL import Image

logger = logging.getLogger(__name__)

LEVELS = (0, 3)
"""Levels whose colours are shown; depth and segmentation are of the last."""

FAR_M = 3.0
"""Depth that is shown black."""


def names(simulator: str) -> list[str]:
    """Returns every value of ``renderer=`` that renders by itself, the simulator's own first."""
    own = [name for name in HANDLERS.get(simulator).own_renderers if name in RENDERERS]
    return list(dict.fromkeys([*own, *RENDERERS, *(name for name in HANDLERS if name != simulator)]))


def draw(task: str, renderers: Sequence[str], *, simulator: str, image_size: int) -> "Image.Image":
    """Draws a task's first training episode with each renderer, one in a row.

    A row shows colours at :data:`LEVELS`, then depth and segmentation. A renderer that cannot run here is
    left out, and logged with the reason.

    Args:
        task: Name of the task.
        renderers: Names of renderers, or of simulators that render.
        simulator: Physics.
        image_size: Pixels along an image's side.

    Raises:
        SimulatorError: if none of them can run here.
    """
    rows = {}
    for name in renderers:
        try:
            images, hidden = _row(task, name, simulator, image_size)
        except (SimulatorError, MissingExtraError) as error:
            logger.warning("Left out %s: %s", name, error)
            continue
        missing = f"; cannot show: {', '.join(hidden)}" if hidden else ""
        rows[f"renderer={name}{missing}"] = images
    if not rows:
        raise SimulatorError(
            f"None of the renderers {', '.join(renderers)} can run here; see what was logged."
        )
    return contact_sheet(rows)


def _row(
    task: str, renderer: str, simulator: str, image_size: int
) -> tuple[list[np.ndarray], tuple[str, ...]]:
    """Returns images (H, W, 3) uint8 of one renderer, and what it cannot show."""
    import envs

    images, drawn, hidden = [], {}, ()
    for level in LEVELS:
        env = envs.make_vec(
            task,
            1,
            level=level,
            split="train",
            simulator=simulator,
            renderer=renderer,
            image_size=image_size,
            num_threads=1,
        )
        try:
            env.reset_envs([0], env.split_indices[:1])
            kinds = ("rgb", "depth", "segmentation")
            drawn = env.handler.render(env.camera_names[:1], kinds)[env.camera_names[0]]
            images.append(drawn["rgb"][0])
            hidden = env.not_shown
        finally:
            env.close()
    return [*images, shaded(drawn["depth"][0]), coloured(drawn["segmentation"][0])], hidden


def shaded(depth: np.ndarray) -> np.ndarray:
    """Returns depth (H, W), m, as grey (H, W, 3) uint8: near is bright, nothing is black."""
    grey = np.where(depth > 0.0, 1.0 - np.clip(depth / FAR_M, 0.0, 1.0), 0.0)
    return np.repeat((255 * grey).astype(np.uint8)[..., None], 3, axis=-1)


def coloured(segmentation: np.ndarray) -> np.ndarray:
    """Returns indices (H, W), -1 for nothing, as colours (H, W, 3) uint8; nothing is black."""
    from colorsys import hsv_to_rgb

    # Steps of the golden ratio keep neighbouring indices apart.
    palette = [(0.0, 0.0, 0.0), *(hsv_to_rgb(0.618 * index % 1.0, 0.6, 0.95) for index in range(64))]
    return (255 * np.array(palette)).astype(np.uint8)[(segmentation + 1) % len(palette)]


@dataclass(frozen=True, kw_only=True, slots=True)
class GallerySettings:
    """``python -m docs.generate.simulator_images``: one scene in every installed renderer and simulator.

    Attributes:
        out: The image.
        task: Registered task.
        simulator: Whose physics.
        renderers: These instead of all, as in renderers=[warp,gl].
        image_size: Height and width of each cell, pixels.
    """

    out: Path = Path("docs/renderers.png")
    task: str = "PickCube"
    simulator: str = "mujoco"
    renderers: tuple[str, ...] = ()
    image_size: int = 192


def main(words: Sequence[str] | None = None) -> int:
    """Draws the image; returns the exit code."""
    return run_program("python -m docs.generate.simulator_images", GallerySettings, _draw, words)


def _draw(given: GallerySettings) -> None:
    chosen = given.renderers or names(given.simulator)
    save(draw(given.task, chosen, simulator=given.simulator, image_size=given.image_size), given.out)


if __name__ == "__main__":
    sys.exit(main())

"""The image of augmentation: hand paths of source demonstrations, of generated ones, and an episode of these.

``python -m docs.generate.augment_image from=<dataset>`` writes ``docs/howto/augment.png`` from a dataset of
NutAssemblySquare, such as ten demonstrations of the expert.
"""

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from envs.core.errors import ConfigError, RoboVerseError
from envs.spec import EnvSpec
from roboverse_learn.data.augmentation.actor import augmented_episodes
from roboverse_learn.data.augmentation.config import AugmentConfig
from roboverse_learn.data.augmentation.planner import AugmentPlanner
from roboverse_learn.data.augmentation.sources import read_sources
from roboverse_learn.data.dataset.recorded_scene import task_of

logger = logging.getLogger(__name__)

OUT = Path("docs/howto/augment.png")
NUM_GENERATED, NUM_FRAMES, FRAME_PIXELS = 40, 6, 256
REACH, CARRY = "#1f77b4", "#d62728"
"""Colours of the hand's path before and after the object is carried."""


def draw(dataset: Path, out: Path) -> None:
    """Draws the image."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    spec = EnvSpec(task=task_of(dataset) or "", cameras=("front",), image_size=FRAME_PIXELS)
    env, config = spec.make(8, num_threads=1), AugmentConfig()
    found = read_sources(dataset, env.task, config)
    planner = AugmentPlanner(env.task, found.sources, config)
    free = [index for index in env.split_indices.tolist() if index not in found.own_episodes]
    made = [
        episode
        for episode in augmented_episodes(env, free[:NUM_GENERATED], planner, 0, record=("states",))
        if episode.success
    ]
    (shown,) = augmented_episodes(env, free[:1], planner, 0, record=("states", "images"))
    env.close()
    carried = found.sources[0].pieces[-1].carried
    figure = plt.figure(figsize=(11.0, 6.6), layout="constrained")
    rows: Any = figure.subfigures(2, 1, height_ratios=(1.6, 1.0))
    axes = rows[0].subplots(1, 2, sharex=True, sharey=True)
    _paths(axes[0], [source.demo.states for source in found.sources], carried)
    _paths(axes[1], [episode.states for episode in made], carried)
    axes[0].set_title(f"{len(found.sources)} source demonstrations, seen from above")
    axes[1].set_title(f"{len(made)} of {NUM_GENERATED} generated from them")
    frames = shown.images["front"][np.linspace(0, shown.length - 1, NUM_FRAMES).astype(int)]
    for axis, frame in zip(rows[1].subplots(1, NUM_FRAMES), frames, strict=True):
        axis.imshow(frame)
        axis.set_axis_off()
    figure.savefig(out, dpi=100, bbox_inches="tight")
    plt.close(figure)


def _paths(axis: Any, states: Sequence[Any], carried: str) -> None:
    """Draws hand paths from above, with where the object begins."""
    for state in states:
        robot, item = next(iter(state.robots.values())), state.objects[carried].pos.numpy()
        hand = robot.ee_pos.numpy()
        lifted = int(np.argmax(item[:, 2] > item[0, 2] + 0.01))
        axis.plot(hand[: lifted + 1, 0], hand[: lifted + 1, 1], color=REACH, lw=0.8)
        axis.plot(hand[lifted:, 0], hand[lifted:, 1], color=CARRY, lw=0.8)
        axis.plot(*item[0, :2], "o", color="black", ms=4)
    axis.set_aspect("equal")
    axis.set_xlabel("x, m")
    axis.set_ylabel("y, m")
    reach, carry = ("to the object", REACH, "-"), ("to its target", CARRY, "-")
    for label, color, style in (reach, carry, ("the object at first", "black", "o")):
        axis.plot([], [], style, color=color, label=label, ms=4)
    axis.legend(loc="upper right", fontsize=8)


def main(argv: Sequence[str] | None = None) -> int:
    """Writes the image; returns the exit code."""
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    parts = [word.partition("=") for word in (sys.argv[1:] if argv is None else argv)]
    words: dict[str, str] = {key: value for key, _, value in parts}
    try:
        if set(words) - {"from", "out"} or not words.get("from"):
            raise ConfigError(
                "Give from=<dataset>, and out=<file> for another file than docs/howto/augment.png."
            )
        out = Path(words.get("out") or OUT)
        draw(Path(words["from"]), out)
    except RoboVerseError as error:
        logger.error("%s", error)
        return 2
    logger.info("Wrote %s.", out)
    return 0


if __name__ == "__main__":
    sys.exit(main())

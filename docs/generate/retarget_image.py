"""The image of retargeting: one recorded episode, and the same hand path followed by other arms.

``python -m docs.generate.retarget_image from=<dataset>`` writes ``docs/howto/retarget.png`` from the first
episode of a dataset of the Franka, such as one of StackCube.
"""

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from envs.core.errors import RoboVerseError
from envs.playback import PlaybackEnv, ReplayActor
from envs.rollout import Episode, rollout
from roboverse_learn.data.dataset.recorded_scene import recorded_spec
from roboverse_learn.data.dataset.recording import Recording, RecordingReader
from roboverse_learn.data.retargeting.actor import retargeted_episodes
from roboverse_learn.data.retargeting.hand_path import HandPathReader
from roboverse_learn.data.retargeting.planner import RetargetPlanner

logger = logging.getLogger(__name__)

OUT = Path("docs/howto/retarget.png")
ROBOTS = ("iiwa", "ur5e", "sawyer_panda", "kinova3")
NUM_FRAMES, FRAME_PIXELS = 5, 224


def episodes(recording: Recording) -> dict[str, Episode]:
    """Returns the recorded episode, rendered, and that of every other arm, by the robot's name."""
    spec = recorded_spec(recording.metadata).replace(cameras=("front",), image_size=FRAME_PIXELS)
    index, start = [int(recording.metadata["episode"])], recording.states.select([0])
    env = spec.make(1, num_threads=1)
    shown = PlaybackEnv(env, [recording.states])
    actor = ReplayActor([start], [recording.actions], hold_steps=0)
    found = {env.task.robot.name: next(rollout(shown, actor, index, record=("images", "states")))}
    path = HandPathReader(env.task.robot).read(recording.states)
    env.close()
    for robot in ROBOTS:
        env = spec.replace(robot=robot).make(1, num_threads=1)
        planner = RetargetPlanner(env.task)
        (found[robot],) = retargeted_episodes(env, index, planner, [start], [path])
        env.close()
    return found


def draw(dataset: str, out: Path) -> None:
    """Draws the image: a row for each robot, in columns of equal times."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    found = episodes(RecordingReader(dataset).read(0))
    shortest = min(episode.length for episode in found.values())
    steps = np.linspace(0, shortest - 1, NUM_FRAMES).astype(int)
    size = (1.6 * NUM_FRAMES, 1.65 * len(found))
    figure, axes = plt.subplots(len(found), NUM_FRAMES, figsize=size, layout="constrained")
    rows: Any = axes
    for row, (name, episode) in zip(rows, found.items(), strict=True):
        for axis, frame in zip(row, episode.images["front"][steps], strict=True):
            axis.imshow(frame)
            axis.set_xticks([])
            axis.set_yticks([])
        row[0].set_ylabel(name + ("" if episode.success else ", failed"))
    figure.savefig(out, dpi=100)
    plt.close(figure)


def main(argv: Sequence[str] | None = None) -> int:
    """Writes the image; returns the exit code."""
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    words = dict(word.split("=", 1) for word in (sys.argv[1:] if argv is None else argv) if "=" in word)
    if set(words) != {"from"}:
        logger.error("Give from=<dataset>, a dataset of the Franka.")
        return 2
    try:
        draw(words["from"], OUT)
    except RoboVerseError as error:
        logger.error("%s", error)
        return 2
    logger.info("Wrote %s.", OUT)
    return 0


if __name__ == "__main__":
    sys.exit(main())

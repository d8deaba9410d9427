"""The image of other robots in a task: the same start and the same expert, on each arm.

``python -m docs.generate.robots_image`` writes ``docs/howto/robots.png``: a column for each robot, of the
first test episode of StackCube at its start, at the grasp and at its end.
"""

from pathlib import Path
from typing import Any

import numpy as np

from envs.experts.actor import expert_episodes
from envs.rollout import Episode
from envs.spec import EnvSpec

OUT = Path("docs/howto/robots.png")
TASK = "StackCube"
ROBOTS = ("franka", "iiwa", "ur5e_2f85", "sawyer_panda", "kinova3", "jaco")
SHARES = (0.0, 0.35, 1.0)
"""Which moments of an episode are shown."""

_PIXELS = 224


def played(robot: str) -> Episode:
    """Returns the expert's first test episode on a robot, rendered."""
    spec = EnvSpec(task=TASK, robot=robot, cameras=("front",), image_size=_PIXELS)
    env = spec.make(1, split="test", num_threads=1)
    try:
        (episode,) = expert_episodes(env, env.split_indices[:1].tolist(), record=("images",))
    finally:
        env.close()
    return episode


def main() -> None:
    """Writes the image."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    size = (1.55 * len(ROBOTS), 1.6 * len(SHARES))
    figure, axes = plt.subplots(len(SHARES), len(ROBOTS), figsize=size, layout="constrained")
    grid: Any = axes
    for column, robot in zip(np.transpose(grid), ROBOTS, strict=True):
        episode = played(robot)
        column[0].set_title(robot + ("" if episode.success else ", failed"), fontsize=9)
        for axis, share in zip(column, SHARES, strict=True):
            axis.imshow(episode.images["front"][round(share * (episode.length - 1))])
            axis.set_axis_off()
    figure.savefig(OUT, dpi=100)
    plt.close(figure)


if __name__ == "__main__":
    main()

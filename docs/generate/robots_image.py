"""The image of other robots in a task: the same start and the same expert, on each arm.

``python -m docs.generate.robots_image`` writes ``docs/howto/robots.png``: a column for each robot, of the
first test episode of StackCube at its start, at the grasp, there also from the wrist, and at its end. It
needs the asset folders ``xarm7`` and ``xarm_gripper``.
"""

from pathlib import Path
from typing import Any

import numpy as np

from envs.experts.actor import expert_episodes
from envs.rollout import Episode
from envs.spec import EnvSpec

OUT = Path("docs/howto/robots.png")
TASK = "StackCube"
ROBOTS = (
    *("franka", "iiwa", "kinova3", "ur5e_2f85"),
    *("sawyer_rethink", "jaco_three_finger", "xarm7_xarm_gripper"),
)
ROWS = (("front", 0.0), ("front", 0.35), ("wrist", 0.35), ("front", 1.0))
"""Which camera is shown, and which moment of an episode."""

_PIXELS = 224


def played(robot: str) -> Episode:
    """Returns the expert's first test episode on a robot, rendered."""
    spec = EnvSpec(task=TASK, robot=robot, cameras=("front", "wrist"), image_size=_PIXELS)
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

    size = (1.55 * len(ROBOTS), 1.6 * len(ROWS))
    figure, axes = plt.subplots(len(ROWS), len(ROBOTS), figsize=size, layout="constrained")
    grid: Any = axes
    for column, robot in zip(np.transpose(grid), ROBOTS, strict=True):
        episode = played(robot)
        column[0].set_title(robot + ("" if episode.success else ", failed"), fontsize=9)
        for axis, (camera, share) in zip(column, ROWS, strict=True):
            axis.imshow(episode.images[camera][round(share * (episode.length - 1))])
            axis.set_axis_off()
    figure.savefig(OUT, dpi=100)
    plt.close(figure)


if __name__ == "__main__":
    main()

"""The image of the SO-101's tasks: what both cameras see at the start, on the way and at the end.

``python -m docs.generate.so101_image`` writes ``docs/howto/so101.png``: a row for each task of the family, of
the first test episode that the expert runs.
"""

from pathlib import Path

import numpy as np
from PIL import Image

from envs.experts.actor import expert_episodes
from envs.spec import EnvSpec
from envs.tasks import TASKS

OUT = Path("docs/howto/so101.png")
HEIGHT = 150
SHARES = (0.0, 0.6, 1.0)
"""Which moments of an episode are shown."""

_COLORS = 128


def row(task: str) -> np.ndarray:
    """Returns the images of one task side by side, (H, W, 3) uint8."""
    env = EnvSpec(task=task, cameras=("front", "wrist"), image_size=HEIGHT).make(
        1, split="test", num_threads=1
    )
    try:
        (episode,) = expert_episodes(env, env.split_indices[:1].tolist(), record=("images",))
    finally:
        env.close()
    moments = [round(share * (episode.length - 1)) for share in SHARES]
    return np.concatenate(
        [episode.images[camera][step] for step in moments for camera in ("front", "wrist")], axis=1
    )


def main() -> None:
    """Writes the image."""
    names = [name for name in TASKS if "so101" in TASKS.entry(name).tags]
    image = Image.fromarray(np.concatenate([row(name) for name in names]))
    image.quantize(_COLORS).save(OUT, optimize=True)


if __name__ == "__main__":
    main()

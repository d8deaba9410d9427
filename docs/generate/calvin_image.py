"""The image of CALVIN: its four scenes, and a chain of five instructions as the expert does it.

``python -m docs.generate.calvin_image`` writes ``docs/howto/calvin.jpg``; CALVIN's files are needed
(``roboverse assets get calvin``).
"""

import logging
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from benchmark.calvin_chains import ENV_TASK, ChainEnv, ChainExpert, run_chains
from docs.generate.level_images import starts
from envs.core.arguments import NoSettings, run_program
from envs.spec import EnvSpec
from envs.tasks.calvin.catalogue import SCENES
from envs.tasks.calvin.sequences import all_chains

logger = logging.getLogger(__name__)

OUT = Path("docs/howto/calvin.jpg")
CHAIN, PIXELS, SCENE_PIXELS, START = 0, 200, 250, 2
LOOKS = {"looks": "meshes"}


def scenes() -> Iterator[EnvSpec]:
    """Yields the environment of each scene."""
    for scene in SCENES:
        task = f"calvin/{scene}/turn_off_led"
        yield EnvSpec(task=task, task_kwargs=LOOKS, cameras=("static",), image_size=SCENE_PIXELS)


def chain() -> np.ndarray:
    """Returns how each instruction of a chain ends, side by side, (H, W, 3) uint8."""
    spec = EnvSpec(task=ENV_TASK, task_kwargs=LOOKS, cameras=("static",), image_size=PIXELS)
    env = spec.make(1, split="test", observation="state")
    images = []
    begin = env.set_instruction

    def shown(env_id: int, instruction: str) -> None:
        images.append(env.image(env_id))
        begin(env_id, instruction)

    env.set_instruction = shown
    chains = ChainEnv(env, {CHAIN: all_chains()[CHAIN]})
    for _, solved in run_chains(chains, ChainExpert(chains), [CHAIN]):
        logger.info("%d of 5 solved: %s", solved, ", ".join(all_chains()[CHAIN][1]))
        images.append(env.image(0))
    env.close()
    return np.hstack(images[1:])


def main(words: Sequence[str] | None = None) -> int:
    """Writes the image; returns the exit code."""
    return run_program("python -m docs.generate.calvin_image", NoSettings, _draw, words)


def _draw(_: NoSettings) -> None:
    Image.fromarray(np.vstack([starts(scenes(), split="test", index=START), chain()])).save(OUT, quality=85)


if __name__ == "__main__":
    sys.exit(main())

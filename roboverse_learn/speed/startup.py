"""Time of a command that does nothing, and of a first image: ``roboverse speed startup``."""

import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import partial

from roboverse_learn.speed.harness import Goal, Measurement, Settings, in_turns, measurement, program

TURNS = 5
GOAL = Goal(1.0, at_least=False, absolute=True)
IMAGE_GOAL = Goal(2.5, at_least=False, absolute=True)

_FIRST_IMAGE = """
import envs

env = envs.make_vec("PickCube", num_envs=1, image_size=128)
observation, _ = env.reset(seed=0)
assert observation["pixels"]["front"].shape == (1, 128, 128, 3)
"""


def parts(_: Settings) -> Mapping[str, Callable[[], Measurement]]:
    """Returns the programs that are timed."""
    commands = {word: partial(startup, word) for word in ("list", "--help")}
    return commands | {"first_image": first_image}


def startup(word: str, turns: int = TURNS) -> Measurement:
    """Compares ``roboverse <word>`` to a Python program that ends at once."""
    ours, empty = (partial(_run, *words) for words in (("-m", "roboverse_learn.cli", word), ("-c", "")))
    return measurement(f"roboverse {word} / an empty Python program", in_turns(ours, empty, turns), GOAL)


def first_image(turns: int = TURNS) -> Measurement:
    """Compares a fresh program that makes an image of PickCube to a Python program that ends at once.

    The first turn, which is not timed, compiles the renderer's kernels and simplifies meshes where a machine
    has not done so before; both are kept on disk.
    """
    ours, empty = partial(_run, "-c", _FIRST_IMAGE), partial(_run, "-c", "")
    name = "a fresh process to its first image, 128×128 / an empty Python program"
    return measurement(name, in_turns(ours, empty, turns), IMAGE_GOAL)


def _run(*words: str) -> None:
    subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    sys.exit(program("startup", Settings, parts))

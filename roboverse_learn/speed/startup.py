"""Time of a command that does nothing, and of a first image: ``roboverse speed startup``."""

import subprocess
import sys
from dataclasses import dataclass
from functools import partial

from roboverse_learn.speed.harness import Goal, Measurement, Program, compare, part

TURNS = 5
GOAL = Goal(1.0, at_least=False, absolute=True)
IMAGE_GOAL = Goal(2.5, at_least=False, absolute=True)

FIRST_IMAGE = """
import envs

env = envs.make_vec("PickCube", num_envs=1, image_size=128)
observation, _ = env.reset(seed=0)
assert observation["pixels"]["front"].shape == (1, 128, 128, 3)
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class Startup(Program):
    """Compares fresh processes to a Python program that ends at once.

    Attributes:
        parts: list, --help, first_image. The first turn of an image, which is not timed, compiles the
            renderer's kernels and simplifies meshes where a machine has not done so before; both are kept
            on disk.
    """

    @part("list", "roboverse list", "-m", "roboverse_learn.cli", "list")
    @part("--help", "roboverse --help", "-m", "roboverse_learn.cli", "--help")
    @part("first_image", "a fresh process to its first image, 128×128", "-c", FIRST_IMAGE, goal=IMAGE_GOAL)
    def started(self, name: str, *words: str, goal: Goal = GOAL) -> Measurement:
        """Compares Python with these words to an empty program."""
        ours, empty = (
            partial(subprocess.run, [sys.executable, *each], check=True, stdout=subprocess.DEVNULL)
            for each in (words, ("-c", ""))
        )
        return compare(f"{name} / an empty Python program", ours, empty, goal, turns=TURNS)

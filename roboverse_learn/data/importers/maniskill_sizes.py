"""Sizes of ManiSkill's peg and box, which PegInsertionSide draws for each episode and does not record.

They follow from a seed, by the generator of numpy and the ranges in
``mani_skill/envs/tasks/tabletop/peg_insertion_side.py`` (Apache-2.0): the episode's own seed where the scene
is built anew in each reset, as for the motion planner, or the seed with which the environment was made, 2022
and those after it for environments beside it. Which one it was is known from where peg and box lie: their
heights at the start are the peg's radius and half length.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from envs.core.errors import DatasetError
from envs.tasks.base import Task

HALF_LENGTH_M, RADIUS_M = (0.085, 0.125), (0.015, 0.025)
FIRST_SEED, MOST_ENVS = 2022, 4096
"""Seed with which ManiSkill makes the first environment, and how many beside it are looked at."""

EXACT_M = 2e-5
"""Largest error of a recorded height."""

ALIKE_M = 2e-4
"""Largest difference of sizes that are the same for a peg with 3 mm of room to each side."""


@dataclass(frozen=True, slots=True)
class PegSizes:
    """Sizes of one episode, m.

    Attributes:
        peg_half_length_m: Half the length of the peg, and of each side of the box.
        peg_radius_m: Half the side of the peg's section.
        hole_offset_m: Place of the hole's axis against the box's middle.
    """

    peg_half_length_m: float
    peg_radius_m: float
    hole_offset_m: tuple[float, float]


def drawn_sizes(seed: int) -> PegSizes:
    """Returns the sizes that follow from a seed."""
    rng = np.random.RandomState(seed)
    half_length, radius = rng.uniform(*HALF_LENGTH_M), rng.uniform(*RADIUS_M)
    y, z = 0.5 * (half_length - radius) * rng.uniform(-1.0, 1.0, size=2)
    return PegSizes(half_length, radius, (float(y), float(z)))


def peg_sizes(peg_z_m: float, box_z_m: float, seed: Any) -> PegSizes:
    """Returns the sizes of an episode.

    Args:
        peg_z_m: Height of the peg at the start.
        box_z_m: Height of the box.
        seed: The episode's seed, or what the file has in its place.

    Raises:
        DatasetError: They follow from no seed that is looked at.
    """
    for each in _seeds(seed):
        sizes = drawn_sizes(each)
        off = max(abs(sizes.peg_radius_m - peg_z_m), abs(sizes.peg_half_length_m - box_z_m))
        if off <= EXACT_M:
            return sizes
    raise DatasetError(
        f"Its peg has a radius of {peg_z_m:.4f} m and half a length of {box_z_m:.4f} m, which follow neither "
        f"from its episode_seed ({seed}) nor from the seeds {FIRST_SEED} to {FIRST_SEED + MOST_ENVS - 1}: "
        "where its hole is cannot be known."
    )


def _seeds(seed: Any) -> Iterable[int]:
    given = seed[0] if isinstance(seed, list) and seed else seed
    if isinstance(given, int) and 0 <= given < 2**32:
        yield given
    yield from range(FIRST_SEED, FIRST_SEED + MOST_ENVS)


def check_sizes(task: Task, sizes: PegSizes) -> None:
    """Checks that a scene has the sizes of an episode.

    Raises:
        DatasetError: It has others.
    """
    wanted = np.array([sizes.peg_half_length_m, sizes.peg_radius_m, *sizes.hole_offset_m])
    own: Any = task
    given = np.array([own.peg_half_length_m, own.peg_radius_m, *own.hole_offset_m])
    if np.abs(wanted - given).max() > ALIKE_M:
        length, radius, y, z = (f"{value:.5f}" for value in wanted)
        raise DatasetError(
            f"Its peg and hole have other sizes. Give task_kwargs.peg_half_length_m={length} "
            f"task_kwargs.peg_radius_m={radius} task_kwargs.hole_offset_m=[{y},{z}]"
        )

"""The channel ``sensor``: noise, blur, JPEG compression and exposure of the cameras, drawn per episode.

What is drawn is a cell, one kind of noise, of blur, of compression and of exposure, and strengths within it.
Every tenth cell is held out for the test split: each of its disturbances occurs in training, never in that
combination.

Ranges are those of the first two severities, of five, of ImageNet-C (Hendrycks & Dietterich 2019,
arXiv:1903.12261, ``make_imagenet_c.py``), from half of the first on: noise of 0.08 and 0.12, shots of 60 and
25 photons at white, blurs of 1 and 2 pixels of 224, JPEG of quality 25 and 18. The ranges of the motion's
length, of exposure and of gamma are chosen here.
"""

import itertools
import math
from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np

from envs.randomization.channels import Channel, Scene, divided
from envs.scenario import Appearance, SensorCfg

NOISES = ("no noise", "gaussian noise", "shot noise")
BLURS = ("no blur", "gaussian blur", "motion blur")
COMPRESSIONS = ("no jpeg", "fine jpeg", "coarse jpeg")
EXPOSURES = ("dark", "as rendered", "bright")

CELLS = tuple(
    " + ".join(parts)
    for parts in itertools.product(NOISES, BLURS, COMPRESSIONS, EXPOSURES)
    if parts != (NOISES[0], BLURS[0], COMPRESSIONS[0], EXPOSURES[1])
)
"""All combinations but the one that disturbs nothing, in an order that stays: 80."""

GAUSSIAN_NOISE = (0.04, 0.12)
SHOT_NOISE = (0.1, 0.2)
"""One over the root of the number of photons at white: 100 to 25."""

BLUR_SIGMA = (0.5 / 224, 2.0 / 224)
MOTION_LENGTH = (4.0 / 224, 14.0 / 224)
FINE_QUALITY, COARSE_QUALITY = (25, 50), (18, 25)
"""Qualities of JPEG, the upper end excluded."""

EXPOSURE_EV = (0.4, 1.2)
GAMMA = (0.85, 1.2)


@dataclass(frozen=True, slots=True)
class SensorDraw:
    """One sample of the channel.

    Attributes:
        cell: One of :data:`CELLS`.
        sensor: What it does to images.
    """

    cell: str
    sensor: SensorCfg


class SensorChannel(Channel):
    """Disturbs the images of all cameras."""

    changes_images: ClassVar[bool] = True

    @override
    def split(self, scene: Scene) -> tuple[str, ...]:
        return divided(CELLS, scene.split.name)

    @override
    def sample(self, rng: np.random.Generator, allowed: tuple[str, ...], scene: Scene) -> SensorDraw:
        cell = allowed[int(rng.integers(len(allowed)))]
        return SensorDraw(cell, strengths_of(cell, rng))

    @override
    def apply(self, appearance: Appearance, draw: SensorDraw, scene: Scene) -> Appearance:
        return replace(appearance, sensor=draw.sensor)


def strengths_of(cell: str, rng: np.random.Generator) -> SensorCfg:
    """Draws the strengths of a cell; all are drawn in every cell: none depends on the others' kinds."""
    noise, blur, compression, exposure = cell.split(" + ")

    def uniform(bounds: tuple[float, float]) -> float:
        return round(float(rng.uniform(*bounds)), 6)

    gaussian, shots, sigma, length = map(uniform, (GAUSSIAN_NOISE, SHOT_NOISE, BLUR_SIGMA, MOTION_LENGTH))
    angle, stops, gamma = map(uniform, ((0.0, math.pi), EXPOSURE_EV, GAMMA))
    fine, coarse = int(rng.integers(*FINE_QUALITY)), int(rng.integers(*COARSE_QUALITY))
    lit = exposure != EXPOSURES[1]
    return SensorCfg(
        exposure_ev={"dark": -stops, "bright": stops}.get(exposure, 0.0),
        gamma=gamma if lit else 1.0,
        blur_sigma=sigma if blur == "gaussian blur" else 0.0,
        motion_length=length if blur == "motion blur" else 0.0,
        motion_angle_rad=angle if blur == "motion blur" else 0.0,
        gaussian_noise=gaussian if noise == "gaussian noise" else 0.0,
        shot_noise=shots if noise == "shot noise" else 0.0,
        jpeg_quality={"fine jpeg": fine, "coarse jpeg": coarse}.get(compression, 0),
        noise_seed=int(rng.integers(2**32)),
    )

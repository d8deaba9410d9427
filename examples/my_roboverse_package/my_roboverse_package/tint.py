"""A channel of one's own, and a level that it is part of: the whole light is warm, neutral or cold."""

from dataclasses import replace
from typing import override

import numpy as np

from envs.randomization import Channel, Scene, divided
from envs.scenario import Appearance

WARMTHS = tuple(round(-0.3 + 0.025 * i, 3) for i in range(25))
"""From cold, -0.3, to warm, 0.3: what red gains and blue loses."""

TINTED = ("environment", "camera", "tint")
"""A level: level 2, and the tint of the light."""


class Tint(Channel):
    """Tints every lamp; what surfaces are made of stays."""

    @override
    def split(self, scene: Scene) -> tuple[float, ...]:
        """Returns the warmths of the split: every tenth is of the test split."""
        return divided(WARMTHS, scene.split.name)

    @override
    def sample(self, rng: np.random.Generator, allowed: tuple[float, ...], scene: Scene) -> dict[str, float]:
        return {"warmth": allowed[int(rng.integers(len(allowed)))]}

    @override
    def apply(self, appearance: Appearance, draw: dict[str, float], scene: Scene) -> Appearance:
        gain = np.array([1.0 + draw["warmth"], 1.0, 1.0 - draw["warmth"]])
        lights = (
            replace(light, color=tuple(np.clip(light.color * gain, 0.0, 1.0).tolist()))
            for light in appearance.lights
        )
        return replace(appearance, lights=tuple(lights))

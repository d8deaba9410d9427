"""The camera channel: moves cameras to poses of the split; the poses are in ``camera_poses``."""

from dataclasses import replace
from typing import override

import numpy as np

from envs.randomization.camera_poses import place_camera
from envs.randomization.channels import Channel, Scene
from envs.scenario import Appearance


class CameraChannel(Channel):
    """Moves each camera that is fixed in the world to one of the split's poses."""

    @override
    def split(self, scene: Scene) -> tuple[str, ...]:
        return tuple(scene.split.cameras)

    @override
    def sample(self, rng: np.random.Generator, allowed: tuple[str, ...], scene: Scene) -> dict[str, str]:
        standing = [camera.name for camera in scene.cameras if camera.mount is None]
        return {name: allowed[int(rng.integers(len(allowed)))] for name in standing}

    @override
    def apply(self, appearance: Appearance, draw: dict[str, str], scene: Scene) -> Appearance:
        moved = {c.name: place_camera(c, draw[c.name]) for c in scene.cameras if c.name in draw}
        return replace(appearance, cameras={**appearance.cameras, **moved})

"""PyBullet: every environment is a physics client of its own, and all share one renderer."""

from collections.abc import Sequence
from typing import override

import mujoco

from envs.handlers.mirrored import MirroredHandler
from envs.handlers.pybullet.settings import SIMULATOR, PybulletSettings
from envs.handlers.pybullet.trees import trees_of
from envs.handlers.pybullet.world import PybulletWorld


class PybulletHandler(MirroredHandler[PybulletSettings]):
    """Bullet by PyBullet; robots and objects are loaded as URDF that :mod:`envs.convert` writes.

    What differs from MuJoCo: friction of two things that touch is the product of both coefficients, where
    MuJoCo takes the larger; a convex mesh is thicker by Bullet's margin of 1 mm; and joints are driven as
    :mod:`envs.handlers.pybullet.drives` says.
    """

    own_renderers = (SIMULATOR,)
    settings_class = PybulletSettings

    @override
    def make_worlds(self, model: mujoco.MjModel) -> Sequence[PybulletWorld]:
        trees = trees_of(model)
        return [PybulletWorld(model, trees, self.settings) for _ in range(self.num_envs)]

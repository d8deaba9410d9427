"""PyBullet: every environment is a physics client of its own, and all share one renderer."""

from collections.abc import Sequence
from typing import override

import mujoco

from envs.simulators.pybullet.settings import SIMULATOR, PybulletSettings
from envs.simulators.pybullet.trees import trees_of
from envs.simulators.pybullet.world import PybulletWorld
from envs.simulators.translated_handler import TranslatedHandler


class PybulletHandler(TranslatedHandler[PybulletSettings]):
    """Bullet by PyBullet; robots and objects are loaded as URDF that :mod:`envs.convert` writes.

    What differs from MuJoCo: friction of two things that touch is the product of both coefficients, where
    MuJoCo takes the larger; a convex mesh is thicker by Bullet's margin of 1 mm; and joints are driven as
    :mod:`envs.simulators.pybullet.drives` says.
    """

    own_renderers = (SIMULATOR,)
    settings_class = PybulletSettings

    @override
    def make_worlds(self, model: mujoco.MjModel) -> Sequence[PybulletWorld]:
        trees = trees_of(model)
        return [PybulletWorld(model, trees, self.settings) for _ in range(self.num_envs)]

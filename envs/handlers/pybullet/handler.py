"""PyBullet: every environment is a physics client of its own, and all share one renderer."""

from typing import override

import mujoco

from envs.handlers.base import TextureSource
from envs.handlers.mirrored import MirroredHandler
from envs.handlers.pybullet.settings import SIMULATOR, PybulletSettings
from envs.handlers.pybullet.trees import Tree, trees_of
from envs.handlers.pybullet.world import PybulletWorld
from envs.scenario import ScenarioCfg


class PybulletHandler(MirroredHandler):
    """Bullet by PyBullet; robots and objects are loaded as URDF that :mod:`envs.convert` writes.

    What differs from MuJoCo: friction of two things that touch is the product of both coefficients, where
    MuJoCo takes the larger; a convex mesh is thicker by Bullet's margin of 1 mm; and joints are driven as
    :mod:`envs.handlers.pybullet.drives` says.
    """

    own_renderers = (SIMULATOR,)

    def __init__(
        self,
        scenario: ScenarioCfg,
        num_envs: int,
        *,
        renderer: str = SIMULATOR,
        num_threads: int = 0,
        textures: TextureSource | None = None,
    ) -> None:
        super().__init__(scenario, num_envs, renderer=renderer, num_threads=num_threads, textures=textures)
        self.settings = PybulletSettings.of(scenario)

    @override
    def launch(self) -> None:
        self._trees: tuple[Tree, ...] | None = None
        super().launch()

    @override
    def make_world(self, model: mujoco.MjModel) -> PybulletWorld:
        if self._trees is None:
            self._trees = trees_of(model)
        return PybulletWorld(model, self._trees, self.settings)

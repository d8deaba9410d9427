"""SAPIEN 3 on CPU: every environment is a PhysX scene of its own, and all share one renderer."""

from typing import override

import mujoco

from envs.handlers.base import TextureSource
from envs.handlers.description import SceneSpec, describe
from envs.handlers.mirrored import MirroredHandler
from envs.handlers.sapien.settings import SIMULATOR, SapienSettings
from envs.handlers.sapien.world import SapienWorld
from envs.scenario import ScenarioCfg


class SapienHandler(MirroredHandler):
    """PhysX (CPU) by SAPIEN; see :mod:`envs.handlers.sapien.world` for what stands for what of MuJoCo.

    The robot is built from the compiled MuJoCo model, not from a URDF: its principal inertias, armature,
    dry friction, limits and force ranges arrive as they are, no file is written, and physics needs no
    renderer, without which SAPIEN's URDF loader fails.
    """

    steps_in_threads = True
    own_renderers = (SIMULATOR, "warp", "gl", "filament")

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
        self.settings = SapienSettings.of(scenario)

    @override
    def launch(self) -> None:
        self._spec: SceneSpec | None = None
        super().launch()

    @override
    def make_world(self, model: mujoco.MjModel) -> SapienWorld:
        if self._spec is None:
            self._spec = describe(model, SIMULATOR)
        return SapienWorld(model, self._spec, self.settings)

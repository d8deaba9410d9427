"""Newton on CPU: every environment is a Newton model of its own; pictures are its ray tracer's."""

import warnings
from typing import override

import mujoco

from envs.handlers.base import TextureSource
from envs.handlers.description import SceneSpec, describe
from envs.handlers.mirrored import MirroredHandler
from envs.handlers.mujoco_warp.device import quiet_start
from envs.handlers.newton.scene import build
from envs.handlers.newton.settings import SIMULATOR, NewtonSettings
from envs.handlers.newton.world import NewtonWorld
from envs.scenario import ScenarioCfg


class NewtonHandler(MirroredHandler):
    """Newton's ``SolverMuJoCo``, which steps a model that Newton's builder was given, not MuJoCo's own file.

    Every link, joint and shape is told to Newton from the compiled model: masses, inertias, limits, gains,
    armature, dry friction, impedances, and which shapes touch. Equality constraints are refused by name.
    """

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
        self.settings = NewtonSettings.of(scenario)

    @override
    def launch(self) -> None:
        quiet_start()
        self._spec: SceneSpec | None = None
        super().launch()

    @override
    def make_world(self, model: mujoco.MjModel) -> NewtonWorld:
        if self._spec is None:
            self._spec = describe(model, SIMULATOR)
        with warnings.catch_warnings():
            # Newton 1.8 was made for MuJoCo 3 and says so of 4, with which our contract tests pass.
            warnings.filterwarnings("ignore", message=".*[Mm]u[Jj]o[Cc]o.*version.*")
            return NewtonWorld(model, build(model, self._spec), self.settings)

"""Newton on CPU: every environment is a Newton model of its own; images are its ray tracer's."""

import warnings
from collections.abc import Sequence
from typing import override

import mujoco

from envs.mjcf.link_tree import describe
from envs.simulators.newton.scene import build
from envs.simulators.newton.settings import SIMULATOR, NewtonSettings
from envs.simulators.newton.world import NewtonWorld
from envs.simulators.translated_handler import TranslatedHandler
from envs.start_warp import start_warp


class NewtonHandler(TranslatedHandler[NewtonSettings]):
    """Newton's ``SolverMuJoCo``, which steps a model made with Newton's builder, not MuJoCo's own file.

    Newton gets every link, joint and shape from the compiled model: masses, inertias, limits, gains,
    armature, dry friction, impedances, and which shapes touch. Equality constraints are refused by name.
    """

    own_renderers = (SIMULATOR, "warp", "gl", "filament")
    settings_class = NewtonSettings
    takes_forces = True

    @override
    def make_worlds(self, model: mujoco.MjModel) -> Sequence[NewtonWorld]:
        start_warp()
        spec = describe(model, SIMULATOR)
        with warnings.catch_warnings():
            # Newton 1.8 was made for MuJoCo 3 and says so of 4, with which our contract tests pass.
            warnings.filterwarnings("ignore", message=".*[Mm]u[Jj]o[Cc]o.*version.*")
            return [NewtonWorld(model, build(model, spec), self.settings) for _ in range(self.num_envs)]

"""SAPIEN 3 on CPU: every environment is a PhysX scene of its own, and all share one renderer."""

from collections.abc import Sequence
from typing import override

import mujoco

from envs.mjcf.link_tree import describe
from envs.simulators.sapien.collision_groups import collision_groups
from envs.simulators.sapien.settings import SIMULATOR, SapienSettings
from envs.simulators.sapien.world import SapienWorld
from envs.simulators.translated_handler import TranslatedHandler


class SapienHandler(TranslatedHandler[SapienSettings]):
    """PhysX (CPU) by SAPIEN; :mod:`envs.simulators.sapien.world` maps MuJoCo's terms to its own.

    The robot is built from the compiled MuJoCo model, not from a URDF: its principal inertias, armature,
    dry friction, limits and force ranges arrive as they are, no file is written, and physics needs no
    renderer, without which SAPIEN's URDF loader fails.
    """

    steps_in_threads = True
    own_renderers = (SIMULATOR, "warp", "gl", "filament")
    settings_class = SapienSettings
    takes_forces = True

    @override
    def make_worlds(self, model: mujoco.MjModel) -> Sequence[SapienWorld]:
        spec = describe(model, SIMULATOR)
        groups = collision_groups(model, spec)
        return [SapienWorld(model, spec, groups, self.settings) for _ in range(self.num_envs)]

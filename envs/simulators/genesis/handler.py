"""Genesis on CPU: all environments are one batch of its rigid solver, rendered with other renderers."""

from collections.abc import Sequence
from typing import override

import mujoco
import numpy as np

from envs.mjcf.link_tree import describe
from envs.simulators.genesis.batch import Batch
from envs.simulators.genesis.settings import SIMULATOR, GenesisSettings
from envs.simulators.translated_handler import TranslatedHandler, World


class GenesisWorld(World):
    """One environment of a batch."""

    def __init__(self, batch: Batch, row: int) -> None:
        self.batch, self._row = batch, row

    @override
    def put(self, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray) -> None:
        self.batch.put(self._row, qpos, qvel, ctrl)

    @override
    def place(self, mocap_pos: np.ndarray, mocap_quat: np.ndarray) -> None:
        self.batch.place(self._row, mocap_pos, mocap_quat)

    @override
    def drive(self, ctrl: np.ndarray) -> None:
        self._ctrl = ctrl.copy()
        self.batch.drive(self._row, ctrl)

    @override
    def step(self, num_steps: int) -> None:
        self.batch.step([self._row], self._ctrl[None], self._ctrl[None], num_steps)

    @override
    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        self.batch.read(self._row, qpos, qvel)

    @override
    def close(self) -> None:
        if self._row == 0:
            self.batch.close()


class GenesisHandler(TranslatedHandler[GenesisSettings]):
    """Genesis's rigid solver, which follows MuJoCo's: impedances, cones and drives mean the same.

    Genesis gets every link, joint and shape from the compiled model. Differences: friction of a contact is
    at least 0.01, contact priorities are ignored, and meshes collide by another algorithm. Genesis's own
    renderer is not offered, since changing materials means rebuilding its scene.
    """

    steps_together = True
    own_renderers = ("warp", "gl", "filament")
    settings_class = GenesisSettings

    @override
    def make_worlds(self, model: mujoco.MjModel) -> Sequence[GenesisWorld]:
        self.batch = Batch(model, describe(model, SIMULATOR), self.settings, self.num_envs)
        return [GenesisWorld(self.batch, row) for row in range(self.num_envs)]

    @override
    def step_worlds(self, rows: Sequence[int], start: np.ndarray | None, num_steps: int) -> None:
        ends = self._ctrl[rows]
        self.batch.step(rows, ends if start is None else start[rows], ends, num_steps)
        for row in rows:
            self.batch.read(row, self._qpos[row], self._qvel[row])

"""Base of simulators that keep the compiled MuJoCo model of a scenario, and render from it."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Unpack, override

import mujoco
import numpy as np

from envs.core.errors import SimulatorError
from envs.mjcf.layout import Layout
from envs.scenario import Appearance, ScenarioCfg
from envs.simulators import RENDERERS
from envs.simulators.base import EnvIds, Handler, HandlerOptions, rows_of
from envs.simulators.mujoco.render import Renderer, RenderJob


def not_running() -> SimulatorError:
    """Returns the error of a simulator that is not launched, or is closed."""
    return SimulatorError("The simulator does not run: call launch() first, and nothing after close().")


class ModelHandler(Handler):
    """A handler with a compiled model, the appearance of each environment, and a renderer.

    Attributes:
        model: The model that is rendered, once launched.
        layout: Where each robot and object lives in the model's arrays, once launched.
    """

    model: mujoco.MjModel
    layout: Layout
    _qpos: np.ndarray
    _mocap_pos: np.ndarray
    _mocap_quat: np.ndarray

    def __init__(self, scenario: ScenarioCfg, num_envs: int, **options: Unpack[HandlerOptions]) -> None:
        super().__init__(scenario, num_envs, **options)
        self._renderer_class: type[Renderer] = RENDERERS.get(self.renderer_name)
        self._renderer: Renderer | None = None
        self._appearances = [scenario.appearance] * num_envs

    @abstractmethod
    def _check_open(self) -> None:
        """Raises :func:`not_running` where nothing runs."""

    @override
    def set_appearance(self, appearance: Appearance, env_id: int) -> None:
        self._appearances[env_id] = appearance

    @override
    def snapshot(self, env_ids: EnvIds = None) -> Sequence[RenderJob]:
        rows = rows_of(env_ids, self.num_envs).tolist()
        return [
            RenderJob(
                qpos=self._qpos[row].copy(),
                mocap_pos=self._mocap_pos[row].copy(),
                mocap_quat=self._mocap_quat[row].copy(),
                appearance=self._appearances[row],
            )
            for row in rows
        ]

    @override
    def render_jobs(
        self,
        jobs: Sequence[RenderJob],
        cameras: Sequence[str] | None = None,
        modalities: Sequence[str] = ("rgb",),
    ) -> dict[str, dict[str, np.ndarray]]:
        names, modalities = self.checked_names(cameras, modalities)
        return self.renderer.render(jobs, names, modalities)

    @property
    def renderer(self) -> Renderer:
        """The renderer, made for the first image."""
        self._check_open()
        if self._renderer is None:
            self._renderer = self._renderer_class(
                self.model, self.scenario, textures=self.textures, num_threads=self.num_threads
            )
        return self._renderer

    @property
    @override
    def segmentation_names(self) -> tuple[str, ...]:
        return self.renderer.segmentation_names

    @property
    @override
    def not_shown(self) -> tuple[str, ...]:
        return self._renderer_class.not_shown

    @override
    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = None

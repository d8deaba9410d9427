"""Renderers of one environment at a time, all on one stage."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import override

import mujoco
import numpy as np

from envs.scenario import Appearance, ScenarioCfg
from envs.simulators.base import TextureSource
from envs.simulators.mujoco.render import Renderer, RenderJob, Stage


class StagedRenderer(Renderer):
    """A renderer with a :class:`Stage`; subclasses set its appearance and poses, and render it."""

    def __init__(
        self,
        model: mujoco.MjModel,
        scenario: ScenarioCfg,
        *,
        textures: TextureSource | None = None,
        num_threads: int = 0,
    ) -> None:
        super().__init__(model, scenario, textures=textures, num_threads=num_threads)
        self._stage = Stage(model, scenario)

    @abstractmethod
    def dress(self, appearance: Appearance) -> None:
        """Makes all look as the stage does, which looks otherwise than for the image before."""

    @abstractmethod
    def pose(self, cameras: tuple[str, ...]) -> None:
        """Sets the poses of everything on the stage, and of the cameras in use."""

    @abstractmethod
    def draw(self, camera: str, out: dict[str, np.ndarray], index: int) -> None:
        """Renders a camera into row ``index`` of the arrays of the requested modalities."""

    @override
    def render(
        self, jobs: Sequence[RenderJob], cameras: tuple[str, ...], modalities: tuple[str, ...]
    ) -> dict[str, dict[str, np.ndarray]]:
        out = self.empty(len(jobs), cameras, modalities)
        for index, job in enumerate(jobs):
            if self._stage.pose(job):
                self.dress(job.appearance)
            self.pose(cameras)
            for name in cameras:
                self.draw(name, out[name], index)
        return out

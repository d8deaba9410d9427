"""N environments of one task as batched pictures, for agents that learn by reward from what cameras see.

Shapes: N environments, F frames of an observation, C = 3 × cameras channels of a frame, P pixels a side.
"""

from collections.abc import Mapping, Sequence
from typing import Any, override

import torch
from torch import Tensor

from envs.core.errors import ConfigError
from envs.randomization import MaterialLibrary
from envs.scenario import ScenarioCfg
from envs.simulators.base import Handler
from envs.simulators.hybrid import make_handler
from envs.state import State
from envs.torch_env import TorchVectorEnv


class PixelVectorEnv(TorchVectorEnv):
    """A :class:`~envs.torch_env.TorchVectorEnv` whose observations are pictures, (N, F C, P, P) uint8.

    An observation is the last F frames, the oldest first, and a frame the pictures of all cameras. Where an
    episode has had fewer, its first one stands in for those before it, as in an evaluation. A frame is drawn
    once; scenes look as at level 0.

    Args:
        task: Name of a task.
        num_envs: N.
        cameras: Names of the cameras, in order; empty is the task's first.
        image_size: P.
        num_frames: F.
        simulator: Name of a simulator.
        renderer: Name of a renderer, or of another simulator that draws the pictures.
        options: Options of :class:`~envs.torch_env.TorchVectorEnv`.

    Attributes:
        camera_names: Names of the cameras.
        observation_shape: (F C, P, P).

    Raises:
        ConfigError: if the task has no camera.
        UnknownNameError: if it has none of a name.
    """

    def __init__(
        self,
        task: str,
        num_envs: int,
        *,
        cameras: Sequence[str] = (),
        image_size: int = 64,
        num_frames: int = 3,
        simulator: str = "mujoco",
        renderer: str = "warp",
        **options: Any,
    ) -> None:
        self._cameras, self._image_size, self._renderer = tuple(cameras), image_size, renderer
        self.num_frames, self._frames = num_frames, torch.empty(0)
        super().__init__(task, num_envs, simulator=simulator, **options)

    @override
    def _make_handler(self, simulator: str, scene: ScenarioCfg, num_threads: int) -> Handler:
        seen = watched(self.task.name, scene, self._cameras, self._image_size)
        self.camera_names = tuple(camera.name for camera in seen.cameras)
        return make_handler(
            simulator,
            seen,
            self.num_envs,
            renderer=self._renderer,
            num_threads=num_threads,
            textures=MaterialLibrary.built_in().texture,
        )

    @override
    def _observe(self, states: State) -> Tensor:
        frame = self._draw()
        self._frames = torch.cat([self._frames[:, frame.shape[1] :], frame], dim=1)
        return self._frames

    @override
    def _observe_begun(self, ids: Tensor) -> Tensor:
        if not len(ids):
            return self._frames
        first = self._draw(ids).repeat(1, self.num_frames, 1, 1)
        if len(ids) == self.num_envs:
            self._frames = first
        else:
            self._frames = self._frames.index_copy(0, ids.to(self.device), first)
        return self._frames

    def _draw(self, ids: Tensor | None = None) -> Tensor:
        """Returns a frame of the environments ``ids``, None all of them, (n, C, P, P) uint8."""
        jobs = None if ids is None else self.handler.snapshot(ids.tolist())
        pictures = self.handler.render_tensors(jobs, self.camera_names)
        frame = torch.cat([pictures[camera]["rgb"] for camera in self.camera_names], dim=-1)
        return frame.permute(0, 3, 1, 2).contiguous().to(self.device)

    @override
    def state_dict(self) -> dict[str, Tensor]:
        return super().state_dict() | {"frames": self._frames.clone()}

    @override
    def load_state_dict(self, state: Mapping[str, Tensor]) -> Tensor:
        super().load_state_dict(state)
        self._frames = state["frames"].to(self.device, copy=True)
        return self._frames


def watched(task: str, scene: ScenarioCfg, cameras: Sequence[str], image_size: int) -> ScenarioCfg:
    """Returns a task's scene with the cameras that an agent learns from, at least one.

    Args:
        task: Name of the task, for the message.
        scene: Its scenario.
        cameras: Names of the cameras, in order; empty is the scene's first.
        image_size: Pixels a side.

    Raises:
        ConfigError: if the scene has no camera.
        UnknownNameError: if it has none of a name.
    """
    seen = scene.seen_by(cameras, image_size)
    if not seen.cameras:
        raise ConfigError(
            f"Task '{task}' has no camera, so there are no pictures to learn from. Learn from its state "
            "(policy.observation=state), or give its scenario a camera."
        )
    return seen

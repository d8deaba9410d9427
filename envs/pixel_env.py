"""N environments of one task with images as tensors, for reinforcement learning from cameras.

Shapes: N environments, F frames of an observation, C = 3 × cameras channels of a frame, P pixels a side, S
numbers of the robot's own state.
"""

from collections.abc import Mapping, Sequence
from typing import Any, override

import torch
from torch import Tensor

from envs.core.errors import ConfigError
from envs.scenario import ScenarioCfg
from envs.simulators.base import Handler
from envs.state import State
from envs.tasks.base import Task
from envs.torch_env import TorchVectorEnv


class PixelVectorEnv(TorchVectorEnv):
    """A :class:`~envs.torch_env.TorchVectorEnv` whose observations are images, (N, F C, P, P) uint8.

    An observation is the last F frames, oldest first; a frame is the images of all cameras. In the first
    steps of an episode its first frame is repeated. Scenes look as at level 0.

    Args:
        task: The task.
        handler: Its simulator, not yet launched; its scene has the cameras that are observed.
        num_frames: F.
        options: Options of :class:`~envs.torch_env.TorchVectorEnv`.

    Attributes:
        num_frames: F.
        image_size: P.
        observation_shape: (F C, P, P).
    """

    def __init__(self, task: Task, handler: Handler, *, num_frames: int = 3, **options: Any) -> None:
        self.num_frames, self._frames = num_frames, torch.empty(0)
        self.image_size = handler.scenario.cameras[0].height
        super().__init__(task, handler, **options)

    @override
    def _observe(self, states: State) -> Tensor:
        frame = self._draw()
        self._frames = torch.cat([self._frames[:, frame.shape[1] :], frame], dim=1)
        return self._frames

    @override
    def _observe_started(self, ids: Tensor) -> Tensor:
        if not len(ids):
            return self._frames
        frame = self._draw(ids)
        first = torch.cat([frame] * self.num_frames, dim=1)
        if len(ids) == self.num_envs:
            self._frames = first
        else:
            self._frames = self._frames.index_copy(0, ids.to(self.device), first)
        return self._frames

    def _draw(self, ids: Tensor | None = None) -> Tensor:
        """Returns a frame of the environments ``ids``, (n, C, P, P) uint8; None means all."""
        jobs = None if ids is None else self.handler.snapshot(ids.tolist())
        cameras = self.camera_names
        images = self.handler.render_tensors(jobs, cameras)
        frame = torch.cat([images[camera]["rgb"] for camera in cameras], dim=-1)
        return frame.permute(0, 3, 1, 2).contiguous().to(self.device)

    @override
    def state_dict(self) -> dict[str, Tensor]:
        return super().state_dict() | {"frames": self._frames.clone()}

    @override
    def load_state_dict(self, state: Mapping[str, Tensor]) -> Tensor:
        super().load_state_dict(state)
        self._frames = state["frames"].to(self.device, copy=True)
        return self._frames


class PixelAndStateVectorEnv(PixelVectorEnv):
    """A :class:`PixelVectorEnv` that also gives the robot's own state, as ``observation.state`` is.

    A frame is a row of bytes, (C P P + 4 S,) uint8: its pixels, then the state's float32. Libraries of
    reinforcement learning keep one tensor per step, of one type.

    Attributes:
        observation_shape: (F (C P P + 4 S),).
        num_state: S.
    """

    @override
    def _draw(self, ids: Tensor | None = None) -> Tensor:
        states = self.handler.get_states(ids)
        own = self.task.proprioception(states).to(self.device).float().contiguous()
        self.num_state = own.shape[1]
        return torch.cat((super()._draw(ids).flatten(1), own.view(torch.uint8)), dim=1)


def watched(task: str, scene: ScenarioCfg, cameras: Sequence[str], image_size: int) -> ScenarioCfg:
    """Returns a task's scene with the cameras that are observed, at least one.

    Args:
        task: Name of the task, for the message.
        scene: Its scenario.
        cameras: Names of the cameras, in order; empty means the scene's first.
        image_size: Pixels a side.

    Raises:
        ConfigError: The scene has no camera.
        UnknownNameError: The scene has no camera of a name.
    """
    seen = scene.seen_by(cameras, image_size)
    if not seen.cameras:
        raise ConfigError(
            f"Task '{task}' has no camera, so there are no images to learn from. Learn from its state "
            "(policy.observation=state), or give its scenario a camera."
        )
    return seen

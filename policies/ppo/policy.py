"""PPO's trained policy, with the interface of every policy, whichever library trained it."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self, override

import numpy as np
import torch
from torch import Tensor

from policies.base import Observation, observed
from policies.byte_rows import pack
from policies.flat_observation import sizes_of
from policies.flat_policy import FlatPolicy
from policies.ppo.config import PpoConfig
from policies.ppo.network import Actor, PixelEncoder, RunningNorm
from policies.stacked_images import stacked

STATE = "observation.state"
"""The key of the robot's own state, which is seen beside images."""


class PpoPolicy(FlatPolicy):
    """The mean action of a Gaussian policy, clipped to [-1, 1]; no noise.

    The statistics that normalize observations are part of it. Of pixels ``sizes`` are those of each camera's
    images, pixels a side, and of the robot's own state.

    Attributes:
        action_size: Entries of an action.
    """

    name: ClassVar[str] = "ppo"

    def __init__(
        self,
        config: PpoConfig,
        sizes: Mapping[str, int],
        action_size: int,
        device: str | torch.device = "cpu",
    ) -> None:
        self.action_size = action_size
        self._cameras = {key: size for key, size in sizes.items() if key != STATE}
        features = RunningNorm(sum(sizes.values()))
        if config.observation == "pixels":
            pixels = max(self._cameras.values())
            features = PixelEncoder(len(self._cameras), pixels, sizes[STATE], config.num_frames)
            self.n_obs_steps = config.num_frames
        model = Actor(features, action_size, config.hidden_dims, config.activation, config.init_std)
        super().__init__(config, model.to(device).eval(), sizes)

    @override
    def seen(self, observation: Observation) -> Tensor:
        if self.config.observation == "state":
            return super().seen(observation)
        frames, state_size = self.n_obs_steps, self.sizes[STATE]
        images = stacked(observation, self._cameras, frames, self.name).unflatten(1, (frames, -1))
        shape = (state_size,) if frames == 1 else (frames, state_size)
        state = observed(observation, STATE, shape, self.name).astype(np.float32)
        return pack(images, torch.from_numpy(state).view(len(state), frames, state_size)).flatten(1)

    @override
    def actions(self, seen: Tensor, generators: Sequence[torch.Generator] | None) -> Tensor:
        return self.model(seen).clamp(-1.0, 1.0)

    @override
    def facts(self) -> dict[str, Any]:
        return {"action_size": self.action_size}

    @classmethod
    @override
    def from_facts(cls, content: Mapping[str, Any], device: str) -> Self:
        values = {**content["config"], "hidden_dims": tuple(content["config"]["hidden_dims"])}
        sizes, action_size = sizes_of(content["observation"]), int(content["action_size"])
        return cls(PpoConfig(**values), sizes, action_size, device)

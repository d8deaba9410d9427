"""PPO's trained policy, with the interface of every policy, whichever library trained it."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self, override

import torch
from torch import Tensor

from policies.flat_observation import sizes_of
from policies.flat_policy import FlatPolicy
from policies.ppo.config import PpoConfig
from policies.ppo.network import Actor


class PpoPolicy(FlatPolicy):
    """The mean action of a Gaussian policy, clipped to [-1, 1]; no noise.

    The statistics that normalize observations are part of it.

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
        size = sum(sizes.values())
        model = Actor(size, action_size, config.hidden_dims, config.activation, config.init_std)
        super().__init__(config, model.to(device).eval(), sizes)

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

"""A trained FastTD3 behind the interface of every policy."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self, override

import torch
from torch import Tensor, nn

from policies.fasttd3.config import FastTd3Config
from policies.fasttd3.networks import Actor, Critics, RunningNorm
from policies.flat_observation import sizes_of
from policies.flat_policy import FlatPolicy


class FastTd3Policy(FlatPolicy):
    """FastTD3, arXiv:2505.22642: it takes the action of its actor, without noise.

    Attributes:
        action_size: Entries of an action.
    """

    name: ClassVar[str] = "fasttd3"

    def __init__(
        self, config: FastTd3Config, sizes: Mapping[str, int], action_size: int, device: str = "cpu"
    ) -> None:
        self.action_size = action_size
        size, norm = sum(sizes.values()), config.layer_norm
        self.norm = RunningNorm(size)
        self.actor = Actor(size, action_size, config.actor_dim, config.init_scale, layer_norm=norm)
        self.critics = Critics(
            size,
            action_size,
            config.critic_dim,
            config.num_atoms,
            config.v_min,
            config.v_max,
            layer_norm=norm,
        )
        parts = {"norm": self.norm, "actor": self.actor, "critics": self.critics}
        super().__init__(config, nn.ModuleDict(parts).to(device), sizes)

    @classmethod
    def create(
        cls,
        config: FastTd3Config,
        sizes: Mapping[str, int],
        action_size: int,
        device: str = "cpu",
        seed: int = 0,
    ) -> Self:
        """Makes an untrained policy.

        Args:
            config: Settings.
            sizes: Keys of the observation, in order, and their sizes.
            action_size: Entries of an action, each in [-1, 1].
            device: Torch device.
            seed: Seed of the first weights.
        """
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            return cls(config, sizes, action_size, device)

    @override
    def actions(self, seen: Tensor, generators: Sequence[torch.Generator] | None) -> Tensor:
        return self.actor(self.norm(seen))

    @override
    def facts(self) -> dict[str, Any]:
        return {"action_size": self.action_size}

    @classmethod
    @override
    def from_facts(cls, content: Mapping[str, Any], device: str) -> Self:
        config = FastTd3Config(**content["config"])
        return cls(config, sizes_of(content["observation"]), int(content["action_size"]), device)

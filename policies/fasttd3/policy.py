"""A trained FastTD3 behind the interface of every policy."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
import torch
from torch import Tensor, nn

from policies import checkpoint
from policies.atomic import atomic_directory
from policies.base import Observation, PolicyError
from policies.fasttd3.config import FastTd3Config
from policies.fasttd3.networks import Actor, Critics, RunningNorm
from policies.flat_observation import check_generators, joined, sizes_of


class FastTd3Policy:
    """FastTD3, arXiv:2505.22642: it takes the action of its actor, without noise.

    Attributes:
        config: Settings.
        model: Actor, critics and normalization of the observations.
        sizes: Keys of the observation, in order, and their sizes.
        action_size: Entries of an action.
        batch_invariant: Run the samples one by one. True on a CPU.
    """

    name: ClassVar[str] = "fasttd3"
    n_obs_steps: ClassVar[int] = 1
    n_action_steps: ClassVar[int] = 1

    def __init__(
        self, config: FastTd3Config, sizes: Mapping[str, int], action_size: int, device: str = "cpu"
    ) -> None:
        self.config, self.sizes, self.action_size = config, dict(sizes), action_size
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
        self.model = nn.ModuleDict(parts).to(device)
        self.batch_invariant = self.device.type == "cpu"

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

    @property
    def device(self) -> torch.device:
        """Where the model is."""
        return self.norm.mean.device

    @property
    def n_params(self) -> int:
        """Parameters that are learned."""
        return sum(parameter.numel() for parameter in self.model.parameters())

    def act(
        self, observation: Observation, generators: Sequence[torch.Generator] | None = None
    ) -> np.ndarray:
        """Chooses the next action; see :meth:`policies.base.Policy.act`."""
        vectors = joined(observation, self.sizes, self.name).to(self.device)
        check_generators(len(vectors), generators)
        with torch.inference_mode():
            rows = vectors.split(1) if self.batch_invariant else (vectors,)
            actions = torch.cat([self.actor(self.norm(row)) for row in rows])
        return actions[:, None].float().cpu().numpy()

    def state_dict(self) -> dict[str, Tensor]:
        """Returns the tensors of the model."""
        return self.model.state_dict()

    def save(self, directory: str | Path) -> None:
        """Writes a checkpoint folder: all of it, or nothing."""
        from safetensors.torch import save_file

        content = {
            "type": self.name,
            "config": dataclasses.asdict(self.config),
            "observation": self.sizes,
            "action_size": self.action_size,
        }
        tensors = {key: value.detach().cpu().contiguous() for key, value in self.state_dict().items()}
        with atomic_directory(directory) as staging:
            (staging / checkpoint.CONFIG).write_text(json.dumps(content, indent=2), encoding="utf-8")
            save_file(tensors, staging / checkpoint.WEIGHTS, metadata={"format": "pt"})

    @classmethod
    def load(cls, directory: str | Path, device: str = "cpu") -> Self:
        """Reads what :meth:`save` wrote; see :meth:`policies.base.Policy.load`."""
        directory = checkpoint.resolve(directory)
        path = directory / checkpoint.CONFIG
        content = checkpoint.read_json(path)
        if content.get("type") != cls.name:
            raise PolicyError(
                f"'{path}' is of policy '{content.get('type')}', not of '{cls.name}'. "
                "Load it with policies.load()."
            )
        weights = checkpoint.read_weights(directory / checkpoint.WEIGHTS)
        try:
            config = FastTd3Config(**content["config"])
            sizes, action_size = sizes_of(content["observation"]), int(content["action_size"])
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise PolicyError(f"'{path}' is not a configuration of policy '{cls.name}': {error}") from error
        policy = cls(config, sizes, action_size, device)
        checkpoint.load_weights(policy.model, weights, directory / checkpoint.WEIGHTS)
        return policy

"""A trained TD-MPC2 behind the interface of every policy."""

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import torch
from torch import Tensor

from policies import checkpoint
from policies.atomic import atomic_directory
from policies.base import Observation, PolicyError
from policies.flat_observation import check_generators, joined, sizes_of
from policies.tdmpc2.config import Tdmpc2Config
from policies.tdmpc2.planner import plan, prior_rollout
from policies.tdmpc2.world_model import WorldModel


class Tdmpc2Policy:
    """TD-MPC2, arXiv:2310.16828, of one task whose state is observed.

    It keeps nothing between calls, so a plan starts from what the policy prior would do, where training
    starts from the plan of the step before; and it values by all members of the ensemble.

    Attributes:
        config: Settings.
        model: The world model.
        sizes: Keys of the observation, in order, and their sizes.
        episode_length: Steps of an episode, from which the discount follows.
        batch_invariant: Run the samples one by one. True on a CPU.
    """

    name: ClassVar[str] = "tdmpc2"
    n_obs_steps: ClassVar[int] = 1
    n_action_steps: ClassVar[int] = 1

    def __init__(
        self, config: Tdmpc2Config, model: WorldModel, sizes: Mapping[str, int], episode_length: int
    ) -> None:
        self.config, self.model = config, model
        self.sizes, self.episode_length = dict(sizes), episode_length
        self.discount = config.discount(episode_length)
        self.batch_invariant = self.device.type == "cpu"

    @classmethod
    def create(
        cls,
        config: Tdmpc2Config,
        sizes: Mapping[str, int],
        action_size: int,
        episode_length: int,
        device: str = "cpu",
        seed: int = 0,
    ) -> Self:
        """Makes an untrained policy.

        Args:
            config: Settings.
            sizes: Keys of the observation, in order, and their sizes.
            action_size: Entries of an action, each in [-1, 1].
            episode_length: Steps of an episode.
            device: Torch device.
            seed: Seed of the first weights.
        """
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            model = WorldModel(config, (sum(sizes.values()),), (action_size,))
        return cls(config, model.to(device).eval(), sizes, episode_length)

    @property
    def device(self) -> torch.device:
        """Where the model is."""
        return self.model.action_masks.device

    @property
    def n_params(self) -> int:
        """Parameters that are learned."""
        return sum(parameter.numel() for parameter in self.model.parameters() if parameter.requires_grad)

    def act(
        self, observation: Observation, generators: Sequence[torch.Generator] | None = None
    ) -> np.ndarray:
        """Chooses the next action; see :meth:`policies.base.Policy.act`."""
        vectors = joined(observation, self.sizes, self.name).to(self.device)
        check_generators(len(vectors), generators)
        with torch.inference_mode():
            if self.batch_invariant:
                rows = [
                    self._act(vectors[i : i + 1], None if generators is None else generators[i : i + 1])
                    for i in range(len(vectors))
                ]
                actions = torch.cat(rows)
            else:
                actions = self._act(vectors, generators)
        return actions[:, None].float().cpu().numpy()

    def _act(self, vectors: Tensor, generators: Sequence[torch.Generator] | None) -> Tensor:
        """Returns actions (n, A)."""
        z = self.model.encode(vectors)
        horizon = self.config.horizon if self.config.plan else 1
        zeros = z.new_zeros(len(z), horizon, 1, self.model.action_size)
        mean = prior_rollout(self.model, z, zeros, mean=True).squeeze(2)
        if not self.config.plan:
            return mean[:, 0]
        normal = _normal(generators, self.device)
        return plan(self.config, self.model, z, mean, self.discount, normal).action.clamp(-1.0, 1.0)

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
            "action_size": self.model.action_size,
            "episode_length": self.episode_length,
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
            config = Tdmpc2Config(**content["config"])
            sizes = sizes_of(content["observation"])
            facts = {key: int(content[key]) for key in ("action_size", "episode_length")}
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise PolicyError(f"'{path}' is not a configuration of policy '{cls.name}': {error}") from error
        policy = cls.create(config, sizes, device=device, **facts)
        checkpoint.load_weights(policy.model, weights, directory / checkpoint.WEIGHTS)
        return policy


def _normal(generators: Sequence[torch.Generator] | None, device: torch.device) -> Callable[..., Tensor]:
    """Returns a source of normal numbers (n, ...), each row of its environment's generator alone."""
    if generators is None:
        return lambda *shape: torch.randn(*shape, device=device)
    own: list[Any] = []
    for generator in generators:
        seed = int(torch.randint(2**62, (), generator=generator))
        own.append(torch.Generator(device).manual_seed(seed))

    def draw(_num: int, *shape: int) -> Tensor:
        return torch.stack([torch.randn(*shape, generator=generator, device=device) for generator in own])

    return draw

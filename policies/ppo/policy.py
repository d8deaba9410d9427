"""What PPO has learned, behind the interface of every policy, whichever library trained it."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
import torch
from torch import Tensor

from policies import checkpoint
from policies.atomic import atomic_directory
from policies.base import Observation, PolicyError
from policies.flat_observation import check_generators, joined, sizes_of
from policies.ppo.config import PpoConfig
from policies.ppo.network import Actor


class PpoPolicy:
    """The mean action of a Gaussian policy, clipped to [-1, 1]; no noise.

    The statistics that normalize observations are part of it.

    Attributes:
        config: Settings.
        model: The network.
        sizes: Keys of the observation, in order, and their sizes.
        action_size: Entries of an action.
        task: Task that it was trained on.
        batch_invariant: Run the samples one by one. True on a CPU.
    """

    name: ClassVar[str] = "ppo"
    n_obs_steps: ClassVar[int] = 1
    n_action_steps: ClassVar[int] = 1

    def __init__(
        self,
        config: PpoConfig,
        sizes: Mapping[str, int],
        action_size: int,
        task: str,
        device: str | torch.device = "cpu",
    ) -> None:
        self.config, self.sizes, self.action_size, self.task = config, dict(sizes), action_size, task
        size = sum(sizes.values())
        model = Actor(size, action_size, config.hidden_dims, config.activation, config.init_std)
        self.model = model.to(device).eval()
        self.batch_invariant = self.device.type == "cpu"

    @property
    def device(self) -> torch.device:
        """Where the model is."""
        return self.model.log_std.device

    @property
    def n_params(self) -> int:
        """Parameters that are learned."""
        return sum(parameter.numel() for parameter in self.model.parameters())

    def act(
        self, observation: Observation, generators: Sequence[torch.Generator] | None = None
    ) -> np.ndarray:
        """Chooses the next action; see :meth:`policies.base.Policy.act`."""
        seen = joined(observation, self.sizes, self.name).to(self.device)
        check_generators(len(seen), generators)
        with torch.inference_mode():
            if self.batch_invariant:
                actions = torch.cat([self.model(row) for row in seen.split(1)])
            else:
                actions = self.model(seen)
        return actions.clamp(-1.0, 1.0)[:, None].float().cpu().numpy()

    def state_dict(self) -> dict[str, Tensor]:
        """Returns the tensors of the model."""
        return self.model.state_dict()

    def save(self, directory: str | Path) -> None:
        """Writes a checkpoint folder: all of it, or nothing."""
        from safetensors.torch import save_file

        content = {
            "type": self.name,
            "task": self.task,
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
            values = {**content["config"], "hidden_dims": tuple(content["config"]["hidden_dims"])}
            policy = cls(
                PpoConfig(**values),
                sizes_of(content["observation"]),
                int(content["action_size"]),
                str(content["task"]),
                device,
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise PolicyError(f"'{path}' is not a configuration of policy '{cls.name}': {error}") from error
        checkpoint.load_weights(policy.model, weights, directory / checkpoint.WEIGHTS)
        return policy

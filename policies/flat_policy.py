"""Reinforcement learning policies: one vector seen, one action chosen, one form of checkpoint."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
import torch
from torch import Tensor

from envs.core.atomic import atomic_directory
from envs.core.errors import PolicyError
from policies import checkpoint
from policies.base import Observation
from policies.flat_observation import check_generators, joined


class FlatPolicy:
    """A network that chooses the next action from a vector, or from what else :meth:`seen` makes of it.

    Subclasses name themselves, choose actions, and say what else is written beside their settings.

    Attributes:
        config: Settings, a dataclass.
        model: The network.
        sizes: Keys of the observation, in order, and their sizes: of images, pixels a side.
        task: Task that it learned, set by the training loop and by its checkpoint; empty if unknown.
            Of several it is the one that it acts in, and may be set.
        batch_invariant: Run the samples one by one. True on a CPU.
    """

    name: ClassVar[str]
    actions_of: ClassVar[Literal["task", "rl"]] = "rl"
    n_obs_steps: int = 1
    n_action_steps: ClassVar[int] = 1

    def __init__(self, config: Any, model: Any, sizes: Mapping[str, int]) -> None:
        self.config, self.model, self.sizes, self.task = config, model, dict(sizes), ""
        self.batch_invariant = self.device.type == "cpu"

    def actions(self, seen: Tensor, generators: Sequence[torch.Generator] | None) -> Tensor:
        """Returns actions (n, A) of observations (n, D) on the model's device."""
        raise NotImplementedError

    def seen(self, observation: Observation) -> Tensor:
        """Returns what the network sees of an observation, (n, D) on the CPU."""
        return joined(observation, self.sizes, self.name)

    def facts(self) -> dict[str, Any]:
        """Returns what a checkpoint says beside settings and sizes; JSON values."""
        raise NotImplementedError

    @classmethod
    def from_facts(cls, content: Mapping[str, Any], device: str) -> Self:
        """Makes the policy that a checkpoint's configuration describes, its weights still to be read.

        Raises:
            KeyError, TypeError, ValueError, AttributeError: if something is absent or of the wrong kind.
        """
        raise NotImplementedError

    @property
    def tasks(self) -> tuple[str, ...]:
        """Every task that it learned; empty if that is not known."""
        return (self.task,) if self.task else ()

    @property
    def device(self) -> torch.device:
        """Device of the model."""
        return next(self.model.parameters()).device

    @property
    def n_params(self) -> int:
        """Parameters that are learned."""
        return sum(parameter.numel() for parameter in self.model.parameters() if parameter.requires_grad)

    def act(
        self, observation: Observation, generators: Sequence[torch.Generator] | None = None
    ) -> np.ndarray:
        """Chooses the next action; see :meth:`policies.base.Policy.act`."""
        seen = self.seen(observation).to(self.device)
        check_generators(len(seen), generators)
        with torch.inference_mode():
            if self.batch_invariant and len(seen) > 1:
                rows = [
                    self.actions(seen[i : i + 1], None if generators is None else generators[i : i + 1])
                    for i in range(len(seen))
                ]
                actions = torch.cat(rows)
            else:
                actions = self.actions(seen, generators)
        return actions[:, None].float().cpu().numpy()

    def state_dict(self) -> dict[str, Tensor]:
        """Returns the tensors of the model."""
        return self.model.state_dict()

    def save(self, directory: str | Path) -> None:
        """Writes a checkpoint folder: all of it, or nothing."""
        from safetensors.torch import save_file

        settings = {"config": dataclasses.asdict(self.config), "observation": self.sizes}
        content = {"type": self.name, "task": self.task, **settings, **self.facts()}
        tensors = {key: value.detach().cpu().contiguous() for key, value in self.state_dict().items()}
        with atomic_directory(directory) as staging:
            (staging / checkpoint.CONFIG).write_text(json.dumps(content, indent=2), encoding="utf-8")
            save_file(tensors, staging / checkpoint.WEIGHTS, metadata={"format": "pt"})
            checkpoint.write_hashes(staging)

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
            policy = cls.from_facts(content, device)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise PolicyError(f"'{path}' is not a configuration of policy '{cls.name}': {error}") from error
        policy.task = str(content.get("task", ""))
        checkpoint.load_weights(policy.model, weights, directory / checkpoint.WEIGHTS)
        return policy

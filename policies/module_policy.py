"""A :class:`policies.trainable.TrainablePolicy` behind the interface of every policy."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Self, override

import torch
from torch import Tensor

from envs.core.errors import PolicyError
from policies.imitation import ACTION, ImitationPolicy
from policies.objective import Loss, Objective
from policies.trainable import TrainablePolicy


class ModulePolicy(ImitationPolicy):
    """Trains and runs a user's module.

    Attributes:
        module_class: Its class.
        model: The module.
    """

    module_class: ClassVar[type[TrainablePolicy]]
    default_compile = False  # a compiler takes a whole graph, which is not asked of a user's module

    def __init__(self, model: TrainablePolicy) -> None:
        self.model = model
        model.registered_name = self.name
        self.batch_invariant = self.device.type == "cpu"

    @classmethod
    @override
    def create(
        cls, features: Mapping[str, Any], stats: Mapping[str, Mapping[str, Any]], config: Any, device: str
    ) -> Self:
        from policies.lerobot_policy import policy_features

        inputs, outputs = policy_features(features)
        shapes = {key: tuple(feature.shape) for key, feature in (inputs | outputs).items()}
        model = cls.module_class(config, shapes)
        model.set_statistics(stats)
        return cls(model.to(device).eval())

    @property
    @override
    def device(self) -> torch.device:
        return next(iter(self.model.state_dict().values())).device

    @property
    @override
    def n_obs_steps(self) -> int:
        return self.model.n_obs_steps

    @property
    @override
    def n_action_steps(self) -> int:
        return self.model.n_action_steps

    @property
    @override
    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        return self.model.shapes

    @property
    @override
    def image_keys(self) -> Sequence[str]:
        return self.model.image_keys

    # --- acting ---------------------------------------------------------------------------------

    @override
    def preprocess(self, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return self.model.dataset_normalizer({key: value.to(self.device) for key, value in batch.items()})

    @override
    def predict(self, batch: dict[str, Tensor], generators: Sequence[torch.Generator] | None) -> Tensor:
        with seeded(generators, self.device):
            actions = self.model.act(batch)
        n, size = len(next(iter(batch.values()))), self.shapes[ACTION][0]
        if not isinstance(actions, Tensor):
            raise PolicyError(f"{self._method('act')} returned a {type(actions).__name__}, not a tensor.")
        chunk = actions.unsqueeze(1) if actions.ndim == 2 else actions
        steps = chunk.shape[1] if chunk.ndim == 3 else 0
        if chunk.shape != (n, steps, size) or steps < self.n_action_steps:
            wanted = f"({n}, {size}) or " if self.n_action_steps == 1 else ""
            raise PolicyError(
                f"{self._method('act')} returned actions of shape {tuple(actions.shape)}; it must be {wanted}"
                f"({n}, T, {size}) with T of at least n_action_steps={self.n_action_steps}."
            )
        return chunk

    @override
    def postprocess(self, actions: Tensor) -> Tensor:
        return self.model.dataset_normalizer.restore(ACTION, actions)

    # --- learning -------------------------------------------------------------------------------

    @property
    @override
    def delta_indices(self) -> dict[str, list[int]]:
        deltas = {ACTION: list(range(self.model.chunk_size))}
        if self.n_obs_steps > 1:
            window = list(range(1 - self.n_obs_steps, 1))
            deltas = {key: window for key in self.shapes} | deltas
        return deltas

    @override
    def loss(self, batch: dict[str, Tensor]) -> Loss:
        returned = self.model.compute_loss(batch)
        loss, terms = returned if isinstance(returned, tuple) else (returned, {})
        if not isinstance(loss, Tensor) or loss.ndim or not loss.requires_grad:
            what = f"shape {tuple(loss.shape)}" if isinstance(loss, Tensor) else f"a {type(loss).__name__}"
            raise PolicyError(
                f"{self._method('compute_loss')} returned {what}. It must be a scalar that depends on the "
                "parameters, such as the mean of an error, or that and a dictionary of numbers."
            )
        numbers = {name: torch.as_tensor(value, device=loss.device) for name, value in terms.items()}
        return loss, {
            name: value.detach().float().mean() for name, value in numbers.items() if name != "loss"
        }

    @override
    def objective(self) -> Objective:
        return Objective(self.model, self.model.dataset_normalizer, self.loss)

    # --- checkpoints ----------------------------------------------------------------------------

    @override
    def save(self, directory: str | Path, weights: Mapping[str, Tensor] | None = None) -> None:
        self.model.save(directory, self.state_dict() if weights is None else weights)

    @classmethod
    @override
    def load(cls, directory: str | Path, device: str = "cpu") -> Self:
        return cls(cls.module_class.load(directory, device))

    def _method(self, name: str) -> str:
        return f"Policy '{self.name}': {type(self.model).__name__}.{name}"


@cache
def module_policy(name: str, module_class: type[TrainablePolicy]) -> type[ModulePolicy]:
    """Returns the policy of a registered module."""
    return type(module_class.__name__, (ModulePolicy,), {"name": name, "module_class": module_class})


@contextmanager
def seeded(generators: Sequence[torch.Generator] | None, device: torch.device) -> Iterator[None]:
    """Seeds torch's global generator from those of the environments, and restores it at its end."""
    if generators is None:
        yield
        return
    draws = [int(torch.randint(2**62, (), generator=generator)) for generator in generators]
    with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
        torch.manual_seed(sum(draws) % 2**63)
        yield

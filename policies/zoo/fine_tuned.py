"""What every policy shares that begins with a network of another program and follows instructions."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, override

import numpy as np
from torch import Tensor

from envs.core.atomic import atomic_directory
from policies import checkpoint
from policies.base import Observation
from policies.imitation import ImitationPolicy
from policies.learned_tasks import TASK_INDEX, Instructions
from policies.zoo import adapters
from policies.zoo.weights import load_tensors, unique_tensors

TASK = "task"
"""Key of the instructions in an observation and a batch."""


class FineTunedPolicy(ImitationPolicy):
    """A policy of another program: its network is trained whole, or by adapters that are saved in its place.

    A subclass writes what its checkpoint has beside the weights, in :meth:`write_settings`.

    Attributes:
        instructions: Of the dataset that is learned; a frame's ``task_index`` counts into them.
    """

    default_compile: ClassVar[bool] = False
    columns: ClassVar[tuple[str, ...]] = (TASK_INDEX,)
    instructions: tuple[str, ...] = ()

    @property
    def network(self) -> Any:
        """The network, without adapters around it."""
        return adapters.base_network(self.model)

    # --- instructions ---------------------------------------------------------------------------

    @override
    def learn_instructions(self, instructions: Instructions) -> None:
        self.instructions = instructions.texts

    @override
    def _to_tensors(self, observation: Observation) -> dict[str, Any]:
        batch: dict[str, Any] = super()._to_tensors(observation)
        words = np.asarray(observation.get(TASK, [""] * len(next(iter(batch.values())))))
        batch[TASK] = [str(each) for each in (words[:, -1] if words.ndim > 1 else words)]
        return batch

    def words(self, batch: Mapping[str, Any], count: int) -> list[str]:
        """Returns the instruction of each of ``count`` samples; empty where a batch names none."""
        if TASK in batch:
            return list(batch[TASK])
        if TASK_INDEX in batch and self.instructions:
            return [self.instructions[int(index)] for index in batch[TASK_INDEX].reshape(-1).tolist()]
        return [""] * count

    # --- checkpoints ----------------------------------------------------------------------------

    @property
    def has_adapters(self) -> bool:
        """Whether adapters are trained and saved, with what is trained beside them, and not the network."""
        return hasattr(self.model, "peft_config")

    @override
    def state_dict(self) -> dict[str, Tensor]:
        return adapters.state(self.model) if self.has_adapters else self.network_state()

    def network_state(self) -> dict[str, Tensor]:
        """Returns the tensors of a network without adapters, by the names of its checkpoint."""
        return super().state_dict()

    @override
    def load_state_dict(self, tensors: Mapping[str, Tensor], path: Path) -> None:
        if self.has_adapters:
            adapters.load_state(self.model, tensors, path)
        else:
            self.load_network(tensors, path)

    def load_network(self, tensors: Mapping[str, Tensor], path: Path) -> None:
        """Copies what :meth:`network_state` returned into the network."""
        load_tensors(self.model, tensors, path)

    @override
    def save(self, directory: str | Path, weights: Mapping[str, Tensor] | None = None) -> None:
        from safetensors.torch import save_file

        tensors = self.state_dict() if weights is None else weights
        with atomic_directory(directory) as staging:
            self.write_settings(staging)
            if self.has_adapters:
                adapters.save(self.model, staging, tensors, Path(directory))
            else:
                save_file(unique_tensors(tensors), staging / checkpoint.WEIGHTS, metadata={"format": "pt"})
            checkpoint.write_hashes(staging)

    def write_settings(self, directory: Path) -> None:
        """Writes ``config.json`` and what else a checkpoint has beside its weights.

        Args:
            directory: The checkpoint, under way.
        """
        raise NotImplementedError

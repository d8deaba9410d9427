"""What the imitation learner and an evaluation need of a policy that learns from demonstrations.

Shapes: n environments or samples, T observations or actions in time, C, H, W an image.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
import torch
from torch import Tensor, nn

from envs.core.errors import PolicyError
from policies.base import Observation, observed
from policies.checkpoint import load_weights
from policies.learned_tasks import Instructions
from policies.objective import Loss

ACTION = "action"


class ImitationPolicy:
    """A network that learns the actions of a dataset, behind the interface of :class:`policies.base.Policy`.

    A network of your own is a :class:`policies.trainable.TrainablePolicy`, which is simpler.

    Attributes:
        model: The network.
        default_ema: Whether training averages the weights by default.
        default_compile: Whether training compiles the loss by default, on a GPU.
        batch_invariant: Run the samples one by one. True on a CPU, where it costs little.
        columns: Further columns of a dataset that the loss takes, of one integer per frame.
    """

    model: Any  # LeRobot's base class does not declare what every policy has
    name: ClassVar[str]
    actions_of: ClassVar[Literal["task", "rl"]] = "task"
    default_ema: ClassVar[bool] = False
    default_compile: ClassVar[bool] = True
    columns: ClassVar[tuple[str, ...]] = ()
    task: str = ""
    batch_invariant: bool

    @classmethod
    def create(
        cls, features: Mapping[str, Any], stats: Mapping[str, Mapping[str, Any]], config: Any, device: str
    ) -> Self:
        """Makes an untrained policy; see :func:`policies.create`."""
        raise NotImplementedError

    def begin_with(self, directory: str | Path) -> None:
        """Takes weights and normalization of a checkpoint, in place of those of an untrained policy.

        Args:
            directory: A pretrained folder, or a run or checkpoint folder that holds one.

        Raises:
            PolicyError: if it is of another policy, of other inputs or of a network of another size, or if
                this policy takes its first weights otherwise.
        """
        del directory
        raise PolicyError(f"policy={self.name} takes no train.resume_from; leave it out.")

    @property
    def device(self) -> torch.device:
        """Device of the model."""
        raise NotImplementedError

    @property
    def n_obs_steps(self) -> int:
        """Observations that one call looks at."""
        raise NotImplementedError

    @property
    def n_action_steps(self) -> int:
        """Actions that one call returns."""
        raise NotImplementedError

    @property
    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        """Shape of one entry of each input and of the action; images (C, H, W)."""
        raise NotImplementedError

    @property
    def image_keys(self) -> Sequence[str]:
        """Inputs that are images."""
        raise NotImplementedError

    @property
    def n_params(self) -> int:
        """Parameters of the model."""
        return sum(parameter.numel() for parameter in self.model.parameters())

    # --- acting ---------------------------------------------------------------------------------

    def act(
        self, observation: Observation, generators: Sequence[torch.Generator] | None = None
    ) -> np.ndarray:
        """Chooses the next actions; see :meth:`policies.base.Policy.act`."""
        batch = self._to_tensors(observation)
        n = len(next(iter(batch.values())))
        if generators is not None and len(generators) != n:
            raise PolicyError(f"act() needs one generator per environment: {n}, given {len(generators)}.")
        was_training = self.model.training
        if was_training:
            self.model.eval()
        with torch.inference_mode():
            batch = self.preprocess(batch)
            if self.batch_invariant and n > 1:
                actions = torch.cat(
                    [
                        self.predict({key: value[i : i + 1] for key, value in batch.items()},
                                     None if generators is None else generators[i : i + 1])
                        for i in range(n)
                    ]
                )  # fmt: skip
            else:
                actions = self.predict(batch, generators)
            chunk = self.postprocess(actions[:, : self.n_action_steps]).float().cpu()
        if was_training:
            self.model.train()
        return chunk.numpy()

    def preprocess(self, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Moves a batch to the device and normalizes it.

        Args:
            batch: Keys of the policy; images (n, [T,] C, H, W), uint8 or float32 from 0 to 1.
        """
        raise NotImplementedError

    def predict(self, batch: dict[str, Tensor], generators: Sequence[torch.Generator] | None) -> Tensor:
        """Returns normalized actions (n, at least n_action_steps, action_dim) of normalized inputs."""
        raise NotImplementedError

    def postprocess(self, actions: Tensor) -> Tensor:
        """Returns the actions of the robot of normalized ones."""
        raise NotImplementedError

    def _to_tensors(self, observation: Observation) -> dict[str, Tensor]:
        """Checks the observation; images become (n, [T,] C, H, W) uint8."""
        batch, images = {}, self.image_keys
        for key, shape in self.shapes.items():
            if key == ACTION:
                continue
            is_image = key in images
            shape = (*shape[1:], shape[0]) if is_image else shape
            shape = (self.n_obs_steps, *shape) if self.n_obs_steps > 1 else shape
            tensor = torch.tensor(observed(observation, key, shape, self.name))
            batch[key] = tensor.movedim(-1, -3).contiguous() if is_image else tensor.float()
        return batch

    # --- learning -------------------------------------------------------------------------------

    @property
    def delta_indices(self) -> dict[str, list[int]]:
        """Frames that a training sample has of each key, relative to its own.

        A key that is absent is taken at the sample's own frame, without a time axis.
        """
        raise NotImplementedError

    @property
    def drop_last_frames(self) -> int:
        """Frames at the end of an episode that are no training samples of their own."""
        return 0

    def training_config(self, config: Any) -> Any:
        """Returns the settings of the optimizer, with those that come with the policy."""
        return config

    def parameter_groups(self) -> list[tuple[list[nn.Parameter], float]]:
        """Returns the trained parameters, each group with its share of the learning rate.

        Returns:
            Nothing where the learner forms the groups.
        """
        return []

    def learn_instructions(self, instructions: Instructions) -> None:
        """Takes the tasks and instructions of the demonstrations, before training.

        Of policies that name ``task_index`` in :attr:`columns`.
        """
        raise NotImplementedError

    def begin_training(self) -> None:
        """Readies the model for gradient steps."""
        self.model.train()

    def end_training(self) -> None:
        """Readies the model for acting."""
        self.model.eval()

    def loss(self, batch: dict[str, Tensor]) -> Loss:
        """Returns the loss of a normalized batch, and its terms, without waiting for a GPU."""
        raise NotImplementedError

    def objective(self) -> nn.Module:
        """Returns the loss of raw frames as a module over :attr:`model`, for gradient steps."""
        raise NotImplementedError

    # --- checkpoints ----------------------------------------------------------------------------

    def state_dict(self) -> dict[str, Tensor]:
        """Returns the tensors of the model."""
        state = self.model.state_dict()
        return {key: value for key, value in state.items() if not key.endswith("num_batches_tracked")}

    def load_state_dict(self, tensors: Mapping[str, Tensor], path: Path) -> None:
        """Copies what :meth:`state_dict` returned into the model.

        Args:
            tensors: The tensors.
            path: Where they are from, for messages.

        Raises:
            PolicyError: if they do not fit.
        """
        load_weights(self.model, tensors, path)

    def save(self, directory: str | Path, weights: Mapping[str, Tensor] | None = None) -> None:
        """Writes a checkpoint folder: all of it, or nothing.

        Args:
            directory: The folder; one of that name is replaced.
            weights: Tensors to save in place of the model's own, as an average of them.
        """
        raise NotImplementedError

    @classmethod
    def load(cls, directory: str | Path, device: str = "cpu") -> Self:
        """Reads a checkpoint folder; see :meth:`policies.base.Policy.load`."""
        raise NotImplementedError

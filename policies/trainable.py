"""Base class of a policy of your own: any ``torch.nn.Module`` that learns from demonstrations.

A whole policy, which ``roboverse train policy=linear task=<name>`` collects for, trains and evaluates::

    @dataclass(frozen=True, kw_only=True)
    class LinearConfig:
        chunk_size: int = 8


    class Linear(TrainablePolicy):
        config_class = LinearConfig

        def __init__(self, config, shapes):
            super().__init__(config, shapes)
            (state,), (action,) = shapes["observation.state"], shapes["action"]
            self.net = nn.Sequential(
                nn.Linear(state, config.chunk_size * action),
                nn.Unflatten(1, (config.chunk_size, action)),
            )

        def compute_loss(self, batch):
            return (self.act(batch) - batch["action"]).abs().mean()

        def act(self, observation):
            return self.net(observation["observation.state"])


    POLICIES.add("linear", "my_package.linear:Linear")
"""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from torch import Tensor, nn

from envs.core.atomic import atomic_directory
from envs.core.errors import PolicyError
from envs.core.observation_keys import IMAGE_PREFIX
from envs.core.ranges import check_ranges
from policies import checkpoint
from policies.normalization import KeyNormalizer, Terms, policy_stats

ACTION = "action"


class TrainablePolicy(nn.Module):
    """A network that learns actions from demonstrations.

    A subclass names its configuration in ``config_class`` and defines ``__init__``, ``compute_loss`` and
    ``act``. The command line, the training loop, checkpoints and the evaluation follow from these.

    The configuration is a frozen dataclass whose fields all have defaults; each field is a key of the command
    line, ``policy.<field>``, with the type of its annotation, and its ``Attributes:`` line is the key's help.
    Where it has them, these fields have a meaning: ``chunk_size``, actions of a training sample (1);
    ``n_action_steps``, actions of a chunk that are executed before ``act`` is called again (``chunk_size``);
    ``n_obs_steps``, observations that the policy looks at, the newest last (1).

    Batches are normalized and on the device of the parameters:

    | key | shape | content |
    |---|---|---|
    | ``observation.state`` | (B, D) float32 | joint positions, mean 0 and deviation 1 |
    | ``observation.images.<name>`` | (B, C, H, W) float32 | a camera, RGB from 0 to 1 |
    | ``action`` | (B, chunk_size, A) float32 | this frame's action and the next ones, scaled likewise |
    | ``action_is_pad`` | (B, chunk_size) bool | true after the episode's end, where the last is repeated |

    The last two are for ``compute_loss`` alone.

    With ``n_obs_steps`` above 1 each observation has a time axis after the first: (B, n_obs_steps, ...).

    Mean and deviation are those of the dataset, where the state is in rad (rotary joints) and m (sliding
    ones), and actions are what the task's controller takes, such as joint targets. Evaluation turns what
    ``act`` returns into these units;
    elsewhere ``self.dataset_normalizer.restore("action", actions)`` does so.

    Args:
        config: Instance of ``config_class``.
        shapes: Shape of one entry of each observation and of the action, such as
            ``{"observation.state": (9,), "observation.images.front": (3, 64, 64), "action": (9,)}``.

    Raises:
        PolicyError: if ``n_action_steps`` or ``n_obs_steps`` of the configuration is out of range.
    """

    config_class: ClassVar[type]

    def __init__(self, config: Any, shapes: Mapping[str, tuple[int, ...]]) -> None:
        super().__init__()
        self.config = config
        self.shapes = {key: tuple(shape) for key, shape in shapes.items()}
        self.registered_name = ""
        self.chunk_size: int = getattr(config, "chunk_size", 1)
        self.n_action_steps: int = getattr(config, "n_action_steps", self.chunk_size)
        self.n_obs_steps: int = getattr(config, "n_obs_steps", 1)
        if not 1 <= self.n_action_steps <= self.chunk_size:
            raise PolicyError(
                f"policy.n_action_steps={self.n_action_steps} must be from 1 to policy.chunk_size="
                f"{self.chunk_size}: only predicted actions can be executed."
            )
        check_ranges(self, "policy.", from_1=("n_obs_steps",), error=PolicyError)
        terms: dict[str, Terms] = {
            key: (torch.zeros(shape), torch.ones(shape), 0.0)
            for key, shape in self.shapes.items()
            if key not in self.image_keys
        }
        self.dataset_normalizer = KeyNormalizer(terms, persistent=True)

    def compute_loss(self, batch: dict[str, Tensor]) -> Tensor | tuple[Tensor, dict[str, Any]]:
        """Returns the loss of a batch, a scalar; with a dictionary of further numbers that are logged.

        The module is in training mode. What is random is drawn from torch's global generator, which is seeded
        at each step, so that a resumed run has the same losses.

        Args:
            batch: See the class.
        """
        raise NotImplementedError(f"{type(self).__name__} has no compute_loss(batch).")

    def act(self, observation: dict[str, Tensor]) -> Tensor:
        """Returns the next action, (B, A), or a chunk of at least ``n_action_steps``, (B, T, A), normalized.

        The module is in evaluation mode, without gradients. What is random is drawn from torch's global
        generator, which is seeded for each episode, so that a repeated evaluation has the same actions.
        On a CPU, B is 1, so that no result depends on what is evaluated beside it.

        Args:
            observation: The observation keys of a batch; see the class.
        """
        raise NotImplementedError(f"{type(self).__name__} has no act(observation).")

    def save(self, directory: str | Path, weights: Mapping[str, Tensor] | None = None) -> None:
        """Writes ``config.json`` and ``model.safetensors`` into a folder: both, or nothing.

        Args:
            directory: The folder; one of that name is replaced.
            weights: Tensors to save in place of the module's own, such as an average of them.

        Raises:
            WriteError: if the disk is full or the folder cannot be written.
        """
        from safetensors.torch import save_file

        weights = self.state_dict() if weights is None else weights
        # Copies, for safetensors refuses tensors that share memory, such as tied weights.
        tensors = {key: value.detach().cpu().contiguous().clone() for key, value in weights.items()}
        shapes = {key: {"shape": list(shape)} for key, shape in self.shapes.items()}
        content = {
            "type": self.registered_name,
            "config": dataclasses.asdict(self.config),
            "output_features": {ACTION: shapes.pop(ACTION)},
            "input_features": shapes,
        }
        with atomic_directory(directory) as staging:
            (staging / checkpoint.CONFIG).write_text(json.dumps(content, indent=2), encoding="utf-8")
            save_file(tensors, staging / checkpoint.WEIGHTS, metadata={"format": "pt"})
            checkpoint.write_hashes(staging)

    @classmethod
    def load(cls, directory: str | Path, device: str = "cpu") -> Self:
        """Reads what :meth:`save` wrote, in evaluation mode.

        Args:
            directory: The folder, or a checkpoint or run folder that holds it.
            device: Torch device.

        Raises:
            PolicyError: if a file is absent, damaged, or does not fit this class.
        """
        from pydantic import TypeAdapter

        directory = checkpoint.resolve(directory)
        path = directory / checkpoint.CONFIG
        content = checkpoint.read_json(path)
        weights = checkpoint.read_weights(directory / checkpoint.WEIGHTS)
        try:
            config = TypeAdapter(cls.config_class).validate_python(content["config"])
            features = content["input_features"] | content["output_features"]
            shapes = {key: tuple(map(int, feature["shape"])) for key, feature in features.items()}
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise PolicyError(f"'{path}' is not a configuration of {cls.__name__}: {error}") from error
        policy = cls(config, shapes)
        policy.registered_name = content.get("type", "")
        checkpoint.load_weights(policy, weights, directory / checkpoint.WEIGHTS)
        return policy.to(device).eval()

    @property
    def image_keys(self) -> list[str]:
        """Keys of the observation that are images."""
        return [key for key in self.shapes if key.startswith(IMAGE_PREFIX)]

    def set_statistics(self, stats: Mapping[str, Mapping[str, Any]]) -> None:
        """Sets what is normalized with; the learner calls it once, before training.

        Args:
            stats: Statistics of a dataset: per key ``mean``, ``std``, ``min`` and ``max``.

        Raises:
            PolicyError: if the dataset has none of a key.
        """
        keys = dict.fromkeys(self.dataset_normalizer.offsets, False)
        for key, of_key in policy_stats(keys, stats, "dataset").items():
            self.dataset_normalizer.set_terms(key, of_key["mean"], of_key["std"])


def check_class(name: str, found: Any) -> type[TrainablePolicy]:
    """Checks what is registered as a policy.

    Raises:
        PolicyError: if it is no :class:`TrainablePolicy`, or its configuration is none.
    """
    where = f"Policy '{name}' is registered as {getattr(found, '__qualname__', repr(found))}, "
    if not (isinstance(found, type) and issubclass(found, TrainablePolicy)):
        raise PolicyError(
            f"{where}which is no subclass of policies.trainable.TrainablePolicy. Derive from it, or register "
            "a policies.PolicyInfo."
        )
    config = getattr(found, "config_class", None)
    if not (isinstance(config, type) and dataclasses.is_dataclass(config)):
        raise PolicyError(
            f"{where}whose config_class is {config!r}. Set it to a frozen dataclass: "
            "@dataclass(frozen=True, kw_only=True)."
        )
    missing = dataclasses.MISSING
    bare = [f.name for f in dataclasses.fields(config) if f.default is missing is f.default_factory]
    if bare:
        raise PolicyError(f"{where}whose {config.__name__} has no default of {', '.join(bare)}. Add one.")
    return found

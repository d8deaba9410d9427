"""Any LeRobot policy, with its processors, behind the interface of :class:`policies.base.Policy`.

Shapes: n environments or samples, T observations or actions in time, C, H, W an image.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.processor import PolicyProcessorPipeline
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE
from torch import Tensor

from envs.core.atomic import atomic_directory
from envs.core.errors import PolicyError
from policies import checkpoint
from policies.imitation import ImitationPolicy
from policies.normalization import policy_stats
from policies.objective import Normalizer, Objective, normalizer_step

type Features = dict[str, PolicyFeature]
type Processors = tuple[PolicyProcessorPipeline, PolicyProcessorPipeline]


class LeRobotPolicy(ImitationPolicy):
    """A LeRobot model and the two pipelines that normalize its inputs and outputs.

    Subclasses name the model and say how it is built; see ``policies/act`` and ``policies/diffusion``.

    Attributes:
        model_classes: LeRobot's name of a policy type to its class; the configuration chooses among them.
        model: LeRobot's policy.
        preprocessor: From observations (and actions) to the numbers that the model sees.
        postprocessor: From the actions of the model to those of the robot.
        processor_steps: Registered names of the processor steps that a checkpoint may use.
    """

    model: Any  # LeRobot's base class does not declare what every policy has
    model_classes: ClassVar[Mapping[str, Any]]
    processor_steps: ClassVar[frozenset[str]] = frozenset(
        {
            "device_processor",
            "normalizer_processor",
            "rename_observations_processor",
            "to_batch_processor",
            "unnormalizer_processor",
        }
    )

    def __init__(self, model: PreTrainedPolicy, processors: Processors) -> None:
        self.model = model
        self.preprocessor, self.postprocessor = processors
        self.batch_invariant = self.device.type == "cpu"

    @classmethod
    def lerobot_config(
        cls, config: Any, inputs: Features, outputs: Features, device: str
    ) -> PreTrainedConfig:
        """Returns LeRobot's configuration of this policy."""
        raise NotImplementedError

    @classmethod
    def lerobot_processors(cls, config: Any, stats: dict[str, dict[str, Tensor]]) -> Processors:
        """Returns LeRobot's processors of this policy."""
        raise NotImplementedError

    @classmethod
    def create(
        cls, features: Mapping[str, Any], stats: Mapping[str, Mapping[str, Any]], config: Any, device: str
    ) -> Self:
        """Makes an untrained policy; see :func:`policies.create`."""
        inputs, outputs = policy_features(features)
        try:
            model = cls.make_model(cls.lerobot_config(config, inputs, outputs, device)).to(device)
        except (ValueError, NotImplementedError) as error:
            raise PolicyError(f"Policy '{cls.name}' cannot be made for this dataset: {error}") from error
        keys = {key: feature.type is FeatureType.VISUAL for key, feature in (inputs | outputs).items()}
        image_stats = config.image_stats
        if image_stats == "auto":
            image_stats = "imagenet" if config.pretrained_backbone_weights else "dataset"
        own_stats = policy_stats(keys, stats, image_stats)
        return cls(model.eval(), cls.lerobot_processors(model.config, own_stats))

    def begin_with(self, directory: str | Path) -> None:
        """See :meth:`policies.imitation.ImitationPolicy.begin_with`."""
        found = type(self).load(directory, str(self.device))
        own, other = ([f"{key} {shape}" for key, shape in each.shapes.items()] for each in (self, found))
        if own != other:
            raise PolicyError(
                f"train.resume_from={directory} is a policy of {', '.join(other)}, and the demonstrations "
                f"have {', '.join(own)}. Give demonstrations with the same cameras, image size and joints."
            )
        checkpoint.load_weights(self.model, found.model.state_dict(), Path(directory))
        self.preprocessor, self.postprocessor = found.preprocessor, found.postprocessor

    @classmethod
    def make_model(cls, config: PreTrainedConfig) -> Any:
        """Returns an untrained model of LeRobot's configuration."""
        return cls.model_classes[config.type](config)

    # --- acting ---------------------------------------------------------------------------------

    @property
    def device(self) -> torch.device:
        """Device of the model."""
        return torch.device(self.model.config.device)

    @property
    def n_obs_steps(self) -> int:
        """Observations that one call looks at."""
        return self.model.config.n_obs_steps

    @property
    def n_action_steps(self) -> int:
        """Actions that one call returns."""
        return self.model.config.n_action_steps

    @property
    def features(self) -> Features:
        """Inputs and outputs."""
        return self.model.config.input_features | self.model.config.output_features

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of one entry of each input and output; images (C, H, W)."""
        return {key: tuple(feature.shape) for key, feature in self.features.items()}

    @property
    def image_keys(self) -> list[str]:
        """Inputs that are images."""
        return list(self.model.config.image_features)

    def predict(self, batch: dict[str, Tensor], generators: Sequence[torch.Generator] | None) -> Tensor:
        """Returns normalized actions (n, at least n_action_steps, action_dim) of normalized inputs."""
        return self.model.predict_action_chunk(batch)

    def postprocess(self, actions: Tensor) -> Tensor:
        """Returns the actions of the robot of normalized ones."""
        return self.postprocessor(actions)

    # --- learning -------------------------------------------------------------------------------

    @property
    def delta_indices(self) -> dict[str, list[int]]:
        """Frames that a training sample has of each key, relative to its own.

        A key that is absent is taken at the sample's own frame, without a time axis.
        """
        config = self.model.config
        deltas = {ACTION: list(config.action_delta_indices)}
        if config.observation_delta_indices is not None:
            deltas |= {key: list(config.observation_delta_indices) for key in config.input_features}
        return deltas

    @property
    def drop_last_frames(self) -> int:
        """Frames at the end of an episode that are no training samples of their own."""
        return getattr(self.model.config, "drop_n_last_frames", 0)

    def preprocess(self, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Moves a batch to the device and normalizes it.

        Args:
            batch: Keys of the policy; images (n, [T,] C, H, W), uint8 or float32 from 0 to 1.

        Returns:
            The batch that the model and its loss take.
        """
        floats = {}
        for key, value in batch.items():
            value = value.to(self.device, non_blocking=True)
            is_bytes = value.dtype is torch.uint8 and key in self.model.config.image_features
            floats[key] = value.float().div_(255.0) if is_bytes else value
        return {key: value for key, value in self.preprocessor(floats).items() if isinstance(value, Tensor)}

    def begin_training(self) -> None:
        """See :meth:`policies.imitation.ImitationPolicy.begin_training`."""
        # Convolutions are faster with channels last, on a GPU and in bf16 on a CPU.
        self.model.to(memory_format=torch.channels_last).train()

    def end_training(self) -> None:
        """Readies the model for acting."""
        self.model.to(memory_format=torch.contiguous_format).eval()

    def objective(self) -> Objective:
        """Returns the loss of raw frames as a module over :attr:`model`, for gradient steps."""
        step = normalizer_step(self.preprocessor)
        return Objective(self.model, Normalizer(step, self.device), self.loss)

    # --- checkpoints ----------------------------------------------------------------------------

    def save(self, directory: str | Path, weights: Mapping[str, Tensor] | None = None) -> None:
        """Writes a LeRobot pretrained folder: all of it, or nothing.

        Args:
            directory: The folder; one of that name is replaced.
            weights: Tensors to save in place of the model's own, as an average of them.
        """
        from safetensors.torch import save_file

        weights = self.state_dict() if weights is None else weights
        tensors = {key: value.detach().cpu().contiguous() for key, value in weights.items()}
        with atomic_directory(directory) as staging:
            self.model.config._save_pretrained(staging)
            save_file(tensors, staging / checkpoint.WEIGHTS, metadata={"format": "pt"})
            self.preprocessor.save_pretrained(staging)
            self.postprocessor.save_pretrained(staging)
            checkpoint.write_hashes(staging)

    @classmethod
    def load(cls, directory: str | Path, device: str = "cpu") -> Self:
        """Reads a LeRobot pretrained folder; see :meth:`policies.base.Policy.load`."""
        directory = checkpoint.resolve(directory)
        config = _load_config(directory, cls.name, cls.model_classes, device)
        weights = checkpoint.read_weights(directory / checkpoint.WEIGHTS)
        processors = _load_processors(directory, device, cls.processor_steps)
        model = cls.make_model(config)
        checkpoint.load_weights(model, weights, directory / checkpoint.WEIGHTS)
        return cls(model.to(device).eval(), processors)


def policy_features(features: Mapping[str, Any]) -> tuple[Features, Features]:
    """Splits the features of a dataset into the inputs and outputs of a policy.

    Raises:
        PolicyError: if there is no action, no state, or neither image nor environment state.
    """
    from lerobot.utils.feature_utils import dataset_to_policy_features

    known = dataset_to_policy_features({key: dict(value) for key, value in features.items()})
    inputs = {
        key: feature
        for key, feature in known.items()
        if feature.type is FeatureType.VISUAL or key in (OBS_STATE, OBS_ENV_STATE)
    }
    for key in (OBS_STATE, ACTION):
        if key not in known:
            raise PolicyError(f"The dataset has no '{key}'. It has: {', '.join(sorted(features))}.")
    if len(inputs) == 1:
        raise PolicyError(
            "The dataset has neither an image (observation.images.<camera>) nor "
            f"{OBS_ENV_STATE}. It has: {', '.join(sorted(features))}."
        )
    return inputs, {ACTION: known[ACTION]}


def _load_config(
    directory: Path, name: str, model_classes: Mapping[str, Any], device: str
) -> PreTrainedConfig:
    import draccus

    path = directory / checkpoint.CONFIG
    content = checkpoint.read_json(path)
    given = content.pop("type", None)
    if given not in model_classes:
        raise PolicyError(f"'{path}' is of policy '{given}', not of '{name}'. Load it with policies.load().")
    content["device"] = str(device)
    if "pretrained_backbone_weights" in content:  # torchvision's would be downloaded
        content["pretrained_backbone_weights"] = None
    try:
        config = draccus.decode(model_classes[given].config_class, content)
        config.validate_features()
        if config.action_feature is None:
            raise ValueError("its outputs have no action")
        return config
    except Exception as error:  # draccus raises several unrelated types
        reason = error.__cause__ or error  # draccus hides what the dataclass said
        raise PolicyError(f"'{path}' is not a configuration of policy '{name}': {reason}") from error


def _load_processors(directory: Path, device: str, allowed: frozenset[str]) -> Processors:
    from lerobot.processor.converters import policy_action_to_transition, transition_to_policy_action

    for name in (checkpoint.PREPROCESSOR, checkpoint.POSTPROCESSOR):
        checkpoint.check_pipeline(directory / name, allowed)
    try:
        preprocessor = PolicyProcessorPipeline.from_pretrained(
            directory, checkpoint.PREPROCESSOR, overrides={"device_processor": {"device": str(device)}}
        )
        postprocessor = PolicyProcessorPipeline.from_pretrained(
            directory,
            checkpoint.POSTPROCESSOR,
            to_transition=policy_action_to_transition,
            to_output=transition_to_policy_action,
        )
    except (OSError, ValueError, KeyError, TypeError, ImportError) as error:
        raise PolicyError(f"The processors of checkpoint '{directory}' cannot be read: {error}") from error
    return preprocessor, postprocessor

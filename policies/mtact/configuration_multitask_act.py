"""LeRobot's configuration of the multi-task policy: ``--policy.type=multitask_act``.

LeRobot finds the model and the processors of a policy type in the modules ``modeling_<type>`` and
``processor_<type>`` beside the module of its configuration.
"""

from dataclasses import dataclass, field, fields

from lerobot.configs import NormalizationMode, PreTrainedConfig

import policies.mtact.inputs_step  # noqa: F401 (LeRobot's commands read a checkpoint's processors by name)
from policies.lerobot_chunk_model import ChunkConfig
from policies.mtact.config import MtActConfig


@PreTrainedConfig.register_subclass("multitask_act")
@dataclass
class MultitaskActConfig(ChunkConfig):
    """Multi-task action chunking by the instruction; see :class:`policies.mtact.config.MtActConfig`.

    Attributes:
        tasks: Sizes of ``observation.state`` and ``action`` of each task that was learned, by its name,
            without padding.
        sentence_size: Width of the frozen encoder's vectors; 0 where words are learned.
        normalization_mapping: How each kind of feature is normalized.
        optimizer_lr: Learning rate of ``lerobot-train``.
        optimizer_weight_decay: Weight decay of ``lerobot-train``.

    Raises:
        PolicyError: A size is out of range.
    """

    tasks: dict[str, dict[str, int]] = field(default_factory=dict)
    sentence_size: int = 0
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: dict.fromkeys(("VISUAL", "STATE", "ACTION"), NormalizationMode.MEAN_STD)
    )
    chunk_size: int = 20
    n_action_steps: int = 10
    head: str = "regression"
    num_inference_steps: int = 5
    text_encoder: str = "scratch"
    text_layers: int = 1
    max_words: int = 32
    num_buckets: int = 4096
    sentence_noise: float = 0.0
    word_dropout: float = 0.0
    vision_backbone: str = "keypoints"
    conv_channels: tuple[int, ...] = (32, 64, 128)
    n_keypoints: int = 32
    tokens_per_camera: int = 4
    dim_model: int = 256
    n_heads: int = 4
    dim_feedforward: int = 1024
    n_encoder_layers: int = 4
    n_decoder_layers: int = 2
    optimizer_lr: float = 3e-4
    optimizer_weight_decay: float = 1e-4

    def __post_init__(self) -> None:
        super().__post_init__()
        MtActConfig(**{name: getattr(self, name) for name in SHARED})  # checks them
        if self.text_encoder != "scratch" and not self.sentence_size:
            from policies.mtact.frozen_text import width_of

            self.sentence_size = width_of(self.text_encoder)


SHARED = tuple(
    sorted(
        {item.name for item in fields(MtActConfig)}
        & {item.name for item in fields(MultitaskActConfig)} - {"tasks"}
    )
)
"""Settings that both configurations have."""

"""LeRobot's configuration of the small Action Chunking Transformer: ``--policy.type=keypoint_act``.

LeRobot finds the model and the processors of a policy type in the modules ``modeling_<type>`` and
``processor_<type>`` beside the module of its configuration.
"""

from dataclasses import dataclass, field, fields

from lerobot.configs import NormalizationMode, PreTrainedConfig

from policies.act.config import ActConfig
from policies.lerobot_chunk_model import ChunkConfig


@PreTrainedConfig.register_subclass("keypoint_act")
@dataclass
class KeypointActConfig(ChunkConfig):
    """Action chunking with a transformer over image keypoints, for training on a CPU.

    Attributes:
        chunk_size: Actions that one forward pass predicts.
        n_action_steps: Actions of a chunk that are executed before the next forward pass.
        normalization_mapping: How each kind of feature is normalized.
        conv_channels: Channels of each convolution of a camera's backbone. The first has a kernel of 6
            pixels and a stride of 4, the others a kernel of 3; their stride is 2, and 1 at the last.
        n_residual_blocks: Residual blocks of two convolutions each that follow these.
        n_keypoints: Keypoints of each camera, by spatial softmax.
        tokens_per_camera: Tokens that the keypoints of a camera become.
        dim_model: Width of the transformer.
        n_heads: Attention heads.
        dim_feedforward: Width of the feed-forward layers.
        n_encoder_layers: Layers of the encoder.
        n_decoder_layers: Layers of the decoder.
        optimizer_lr: Learning rate of ``lerobot-train``.
        optimizer_weight_decay: Weight decay of ``lerobot-train``.

    Raises:
        PolicyError: A size is out of range; see :class:`policies.act.config.ActConfig`.
    """

    chunk_size: int = 20
    n_action_steps: int = 10
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: dict.fromkeys(("VISUAL", "STATE", "ACTION"), NormalizationMode.MEAN_STD)
    )
    conv_channels: tuple[int, ...] = (32, 32, 64)
    n_residual_blocks: int = 0
    n_keypoints: int = 32
    tokens_per_camera: int = 4
    dim_model: int = 128
    n_heads: int = 4
    dim_feedforward: int = 512
    n_encoder_layers: int = 1
    n_decoder_layers: int = 1
    optimizer_lr: float = 1e-3
    optimizer_weight_decay: float = 1e-4

    def __post_init__(self) -> None:
        super().__post_init__()
        shared = {item.name for item in fields(ActConfig)} & {item.name for item in fields(self)}
        ActConfig(**{name: getattr(self, name) for name in shared})  # checks them

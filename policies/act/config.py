"""Settings of the Action Chunking Transformer."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from envs.core.errors import PolicyError
from envs.core.ranges import check_ranges


@dataclass(frozen=True, kw_only=True, slots=True)
class ActConfig:
    """Action Chunking Transformer, arXiv:2304.13705; the defaults are those of the original code.

    With ``vision_backbone=keypoints`` it is the small network of
    :mod:`policies.act.modeling_keypoint_act`, which learns on a CPU. Settings of the ResNet and of the
    variational encoder have no effect on it.

    Attributes:
        chunk_size: Actions that one forward pass predicts.
        n_action_steps: Actions of a chunk that are executed before the next forward pass.
        dim_model: Width of the transformer.
        n_heads: Attention heads.
        dim_feedforward: Width of the feed-forward layers.
        n_encoder_layers: Layers of the encoder.
        n_decoder_layers: Layers of the decoder. The original asks for 7 and, by a mistake in its code,
            uses the first alone (github.com/tonyzhaozh/act/issues/25).
        use_vae: Train with the variational encoder of action chunks; its style variable is zero when
            the policy acts.
        n_vae_encoder_layers: Layers of the variational encoder.
        latent_dim: Size of its style variable.
        kl_weight: Weight of the KL term of the loss.
        dropout: Dropout of the transformer layers.
        vision_backbone: A ResNet of torchvision, or ``keypoints`` for a small one with spatial softmax.
        pretrained_backbone_weights: Name of torchvision weights, such as
            ``ResNet18_Weights.IMAGENET1K_V1``, which are downloaded; None starts at random.
        backbone_norm: ``frozen`` keeps the normalization layers of the backbone as they are loaded, which
            is right for pretrained weights; ``batch`` trains them as batch normalization and saves them
            frozen; ``auto`` is ``frozen`` with pretrained weights and ``batch`` without.
        image_stats: Mean and standard deviation that images are normalized with: of the ``dataset``, of
            ``imagenet``, or ``half`` (0.5 and 0.5); ``auto`` is ``imagenet`` with pretrained weights and
            ``dataset`` without.
        mask_padding: Leave the actions after the end of an episode, which repeat its last, out of the loss,
            as the original does. Without it the policy learns to hold still there.
        state_noise: Standard deviation of the noise that training adds to the normalized joint positions.
        conv_channels: Of ``keypoints``: channels of each convolution of a camera, multiples of 8.
        n_residual_blocks: Of ``keypoints``: residual blocks of two convolutions each that follow these.
        n_keypoints: Of ``keypoints``: keypoints of each camera.
        tokens_per_camera: Of ``keypoints``: tokens that the keypoints of a camera become.
    """

    younger: ClassVar[tuple[str, ...]] = ("n_residual_blocks",)
    """Keys that are no part of a run's name at their defaults: older runs, made without them, keep theirs."""

    chunk_size: int = 100
    n_action_steps: int = 100
    dim_model: int = 512
    n_heads: int = 8
    dim_feedforward: int = 3200
    n_encoder_layers: int = 4
    n_decoder_layers: int = 1
    use_vae: bool = True
    n_vae_encoder_layers: int = 4
    latent_dim: int = 32
    kl_weight: float = 10.0
    dropout: float = 0.1
    vision_backbone: Literal["resnet18", "resnet34", "resnet50", "keypoints"] = "resnet18"
    pretrained_backbone_weights: str | None = None
    backbone_norm: Literal["auto", "batch", "frozen"] = "auto"
    image_stats: Literal["auto", "dataset", "imagenet", "half"] = "auto"
    mask_padding: bool = True
    state_noise: float = 0.0
    conv_channels: tuple[int, ...] = (32, 32, 64)
    n_residual_blocks: int = 0
    n_keypoints: int = 32
    tokens_per_camera: int = 4

    def __post_init__(self) -> None:
        if not 1 <= self.n_action_steps <= self.chunk_size:
            raise PolicyError(
                f"policy.n_action_steps={self.n_action_steps} must be from 1 to policy.chunk_size="
                f"{self.chunk_size}: only predicted actions can be executed."
            )
        if self.dim_model <= 0 or self.dim_model % self.n_heads or self.dim_model % 4:
            raise PolicyError(
                f"policy.dim_model={self.dim_model} must be a multiple of 4 and of policy.n_heads="
                f"{self.n_heads}, such as {max(1, self.dim_model // (4 * self.n_heads)) * 4 * self.n_heads}."
            )
        if not 0.0 <= self.dropout < 1.0:
            raise PolicyError(f"policy.dropout must be from 0 to below 1, given {self.dropout}.")
        if not 0.0 <= self.state_noise < float("inf"):
            raise PolicyError(f"policy.state_noise must be 0 (off) or more, given {self.state_noise}.")
        if not self.conv_channels or any(width <= 0 or width % 8 for width in self.conv_channels):
            raise PolicyError(
                f"policy.conv_channels={list(self.conv_channels)} must be multiples of 8, "
                "such as [16,32,64,64]."
            )
        from_1 = ("n_keypoints", "tokens_per_camera")
        check_ranges(self, "policy.", from_1=from_1, from_0=("n_residual_blocks",), error=PolicyError)

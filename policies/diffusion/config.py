"""Settings of Diffusion Policy."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from envs.core.errors import PolicyError
from envs.core.ranges import check_ranges


@dataclass(frozen=True, kw_only=True, slots=True)
class DiffusionConfig:
    """Diffusion Policy, arXiv:2303.04137, with the convolutional network.

    The defaults are those of RoboVerse (arXiv:2504.18904 and its code): a ResNet18 and a U-Net of
    (256, 512, 1024) channels, three observations, eight predicted and four executed actions.
    With ``vision_backbone=keypoints`` each camera has small convolutions in place of a ResNet
    (:mod:`policies.keypoint_backbone`), which take less time and say more exactly where a thing is.

    Attributes:
        n_obs_steps: Observations, the newest last, that the network is given.
        horizon: Actions that are denoised together, beginning with that of the oldest observation; a
            multiple of ``2 ** len(down_dims)``.
        n_action_steps: Actions that are executed before the next denoising.
        down_dims: Channels of the stages of the U-Net.
        kernel_size: Kernel of its convolutions.
        diffusion_step_embed_dim: Size of the embedding of the diffusion step.
        spatial_softmax_num_keypoints: Image points that the encoder returns.
        vision_backbone: A ResNet of torchvision, with group normalization if it starts at random, or
            ``keypoints`` for a small network.
        pretrained_backbone_weights: Name of torchvision weights, such as
            ``ResNet18_Weights.IMAGENET1K_V1``, which are downloaded; None starts at random.
        crop_ratio: Side of the random crop (the central one when acting), relative to the image; 1
            crops nothing.
        noise_scheduler_type: ``DDPM``, or ``DDIM``, which can act with few steps.
        num_train_timesteps: Diffusion steps of training.
        num_inference_steps: Denoising steps when acting; None takes ``num_train_timesteps``.
        prediction_type: What the network predicts, the noise (``epsilon``) or the actions (``sample``).
        image_stats: See :class:`policies.act.config.ActConfig`.
        state_noise: Standard deviation of the noise that training adds to the normalized joint positions.
        conv_channels: Of ``keypoints``: channels of each convolution of a camera, multiples of 8.
        n_residual_blocks: Of ``keypoints``: residual blocks of two convolutions each that follow these.
        drop_n_last_frames: Frames at the end of an episode that are no training samples of their own; None is
            ``horizon - n_action_steps - n_obs_steps + 1``, as in the original. With 0 the policy learns to
            hold still at the end: actions after it repeat the last.
    """

    younger: ClassVar[tuple[str, ...]] = (
        *("state_noise", "conv_channels", "n_residual_blocks", "drop_n_last_frames"),
    )
    """Keys that are no part of a run's name at their defaults: older runs, made without them, keep theirs."""

    n_obs_steps: int = 3
    horizon: int = 8
    n_action_steps: int = 4
    down_dims: tuple[int, ...] = (256, 512, 1024)
    kernel_size: int = 5
    diffusion_step_embed_dim: int = 128
    spatial_softmax_num_keypoints: int = 32
    vision_backbone: Literal["resnet18", "resnet34", "resnet50", "keypoints"] = "resnet18"
    pretrained_backbone_weights: str | None = None
    crop_ratio: float = 1.0
    noise_scheduler_type: Literal["DDPM", "DDIM"] = "DDPM"
    num_train_timesteps: int = 100
    num_inference_steps: int | None = None
    prediction_type: Literal["epsilon", "sample"] = "epsilon"
    image_stats: Literal["auto", "dataset", "imagenet", "half"] = "auto"
    state_noise: float = 0.0
    conv_channels: tuple[int, ...] = (32, 32, 64)
    n_residual_blocks: int = 0
    drop_n_last_frames: int | None = None

    def __post_init__(self) -> None:
        factor = 2 ** len(self.down_dims)
        if self.horizon <= 0 or self.horizon % factor:
            near = max(1, round(self.horizon / factor)) * factor
            raise PolicyError(
                f"policy.horizon={self.horizon} must be a multiple of {factor}, because the U-Net of policy."
                f"down_dims={tuple(self.down_dims)} halves it {len(self.down_dims)} times; take {near}."
            )
        longest = self.horizon - self.n_obs_steps + 1
        if not 1 <= self.n_action_steps <= longest:
            raise PolicyError(
                f"policy.n_action_steps={self.n_action_steps} must be from 1 to {longest}: of the "
                f"{self.horizon} predicted actions, policy.n_obs_steps - 1 = {self.n_obs_steps - 1} are past."
            )
        from_0 = ("n_residual_blocks", "drop_n_last_frames")
        from_1 = ("n_obs_steps", "spatial_softmax_num_keypoints")
        check_ranges(self, "policy.", from_0=from_0, from_1=from_1, error=PolicyError)
        for name in ("down_dims", "conv_channels"):
            widths = getattr(self, name)
            if not widths or any(width % 8 or width <= 0 for width in widths):
                raise PolicyError(f"policy.{name} must be multiples of 8, given {tuple(widths)}.")
        if not 1 <= (self.num_inference_steps or self.num_train_timesteps) <= self.num_train_timesteps:
            raise PolicyError(
                f"policy.num_inference_steps={self.num_inference_steps} must be from 1 to "
                f"policy.num_train_timesteps={self.num_train_timesteps}."
            )
        if not 0.0 < self.crop_ratio <= 1.0:
            raise PolicyError(f"policy.crop_ratio must be above 0 and at most 1, given {self.crop_ratio}.")
        if not 0.0 <= self.state_noise < float("inf"):
            raise PolicyError(f"policy.state_noise must be 0 (off) or more, given {self.state_noise}.")
        if self.vision_backbone == "keypoints":
            self._check_has_no_resnet()

    def _check_has_no_resnet(self) -> None:
        if self.crop_ratio < 1.0:
            raise PolicyError(
                f"policy.crop_ratio={self.crop_ratio} is of a ResNet. With policy.vision_backbone=keypoints, "
                "train.augment.shift_px=4 moves the images in its place."
            )
        if self.pretrained_backbone_weights is not None:
            raise PolicyError(
                f"policy.pretrained_backbone_weights={self.pretrained_backbone_weights} is of a ResNet, and "
                "policy.vision_backbone=keypoints has none. Leave one of both out."
            )

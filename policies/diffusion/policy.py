"""The Diffusion Policy of LeRobot."""

from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig as LeRobotDiffusionConfig
from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy as LeRobotDiffusionPolicy
from lerobot.policies.diffusion.modeling_diffusion import DiffusionRgbEncoder
from lerobot.policies.diffusion.processor_diffusion import make_diffusion_pre_post_processors
from lerobot.utils.constants import OBS_IMAGES, OBS_STATE
from torch import Tensor, nn

from policies.diffusion.config import DiffusionConfig
from policies.diffusion.configuration_keypoint_diffusion import KeypointDiffusionConfig
from policies.diffusion.modeling_keypoint_diffusion import KeypointDiffusionPolicy
from policies.group_norm import ChannelsLastGroupNorm
from policies.lerobot_policy import Features, LeRobotPolicy, Processors
from policies.objective import Loss
from policies.swap_modules import replace_modules


class DiffusionPolicy(LeRobotPolicy):
    """Diffusion Policy, arXiv:2303.04137."""

    name = "diffusion"
    model_classes: ClassVar = {
        "diffusion": LeRobotDiffusionPolicy,
        "keypoint_diffusion": KeypointDiffusionPolicy,
    }
    default_ema = True
    _state_noise = 0.0

    @classmethod
    def lerobot_config(
        cls, config: DiffusionConfig, inputs: Features, outputs: Features, device: str
    ) -> PreTrainedConfig:
        """Returns LeRobot's configuration."""
        dropped = config.drop_n_last_frames
        if dropped is None:
            dropped = max(0, config.horizon - config.n_action_steps - config.n_obs_steps + 1)
        shared: dict[str, Any] = dict(
            device=device,
            input_features=inputs,
            output_features=outputs,
            push_to_hub=False,
            n_obs_steps=config.n_obs_steps,
            horizon=config.horizon,
            n_action_steps=config.n_action_steps,
            drop_n_last_frames=dropped,
            down_dims=tuple(config.down_dims),
            kernel_size=config.kernel_size,
            diffusion_step_embed_dim=config.diffusion_step_embed_dim,
            spatial_softmax_num_keypoints=config.spatial_softmax_num_keypoints,
            noise_scheduler_type=config.noise_scheduler_type,
            num_train_timesteps=config.num_train_timesteps,
            num_inference_steps=config.num_inference_steps,
            prediction_type=config.prediction_type,
        )
        if config.vision_backbone == "keypoints":
            return KeypointDiffusionConfig(
                **shared,
                conv_channels=tuple(config.conv_channels),
                n_residual_blocks=config.n_residual_blocks,
            )
        image = next((feature.shape for feature in inputs.values() if len(feature.shape) == 3), None)
        crop = None
        if image is not None and config.crop_ratio < 1.0:
            crop = (int(image[1] * config.crop_ratio), int(image[2] * config.crop_ratio))
        return LeRobotDiffusionConfig(
            **shared,
            vision_backbone=config.vision_backbone,
            pretrained_backbone_weights=config.pretrained_backbone_weights,
            use_group_norm=config.pretrained_backbone_weights is None,
            crop_shape=crop,
        )

    @classmethod
    def create(cls, features: Any, stats: Any, config: DiffusionConfig, device: str) -> "DiffusionPolicy":
        """Makes an untrained policy; see :func:`policies.create`."""
        policy = super().create(features, stats, config, device)
        policy._state_noise = config.state_noise
        return policy

    @classmethod
    def lerobot_processors(cls, config: Any, stats: dict[str, dict[str, Tensor]]) -> Processors:
        """Returns LeRobot's processors."""
        return make_diffusion_pre_post_processors(config, dataset_stats=stats)

    def predict(self, batch: dict[str, Tensor], generators: Sequence[torch.Generator] | None) -> Tensor:
        """Denoises the actions; the generators give all noise: the initial and that of every DDPM step."""
        model, config = self.model.diffusion, self.model.config
        if config.n_obs_steps == 1:  # observations have no time axis, the network needs one
            batch = {key: batch[key].unsqueeze(1) for key in config.input_features}
        if generators is None:
            return self.model.predict_action_chunk(batch)
        if config.image_features:
            images = torch.stack([batch[key] for key in config.image_features], dim=-4)
            batch = batch | {OBS_IMAGES: images}
        shape = (1, config.horizon, config.action_feature.shape[0])
        noise = torch.cat([torch.randn(shape, generator=generator) for generator in generators])
        # generate_actions() has no generator argument, so its two steps are taken here.
        sample = model.conditional_sample(
            len(noise),
            global_cond=model._prepare_global_conditioning(batch),
            generator=list(generators),
            noise=noise.to(self.device),
        )
        start = config.n_obs_steps - 1
        return sample[:, start : start + config.n_action_steps]

    def begin_training(self) -> None:
        """Readies the model for gradient steps."""
        if isinstance(self.model, KeypointDiffusionPolicy):
            self.model.train()  # group normalization wants channels first, so channels last would be copied
            return
        for module in self.model.modules():
            if isinstance(module, DiffusionRgbEncoder):
                replace_modules(module.backbone, nn.GroupNorm, ChannelsLastGroupNorm.of)
        super().begin_training()

    def loss(self, batch: dict[str, Tensor]) -> Loss:
        """Returns the mean squared error of the network's answer to noised actions."""
        config = self.model.config
        if self._state_noise:
            state = batch[OBS_STATE]
            batch = batch | {OBS_STATE: state + self._state_noise * torch.randn_like(state)}
        if config.image_features:
            images = [batch[key] for key in config.image_features]
            images = [image.unsqueeze(1) if image.ndim == 4 else image for image in images]
            batch = batch | {OBS_IMAGES: torch.stack(images, dim=-4)}
        return self.model.diffusion.compute_loss(batch), {}

"""The Action Chunking Transformer of LeRobot."""

from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any, ClassVar

import numpy as np
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.act.processor_act import make_act_pre_post_processors
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE
from torch import Tensor, nn
from torchvision.ops.misc import FrozenBatchNorm2d

from policies.act.config import ActConfig
from policies.act.configuration_keypoint_act import KeypointActConfig
from policies.act.modeling_keypoint_act import KeypointActPolicy
from policies.base import Observation
from policies.lerobot_policy import Features, LeRobotPolicy, Processors
from policies.objective import Loss
from policies.packed_convolutions import packed
from policies.swap_modules import replace_modules

# Running statistics average over about 50 batches, so that the frozen ones are not those of a few images.
_NORM_MOMENTUM = 0.02


class ActPolicy(LeRobotPolicy):
    """Action Chunking Transformer, arXiv:2304.13705.

    LeRobot's backbone has frozen batch normalization, as the original, which starts from ImageNet
    weights. From random weights that is no normalization at all, and the backbone learns slowly. So it
    is trained with batch normalization, whose tensors have the same names and the same meaning: what
    is saved is a plain LeRobot checkpoint that acts as the trained network does.
    """

    name = "act"
    model_classes: ClassVar = {"act": ACTPolicy, "keypoint_act": KeypointActPolicy}
    _train_batch_norm = False
    _mask_padding = True
    _state_noise = 0.0

    def __init__(self, model: PreTrainedPolicy, processors: Processors) -> None:
        super().__init__(model, processors)
        self._network: Any = None  # what acts, once it did; a copy of the model's on a CPU
        model.register_load_state_dict_post_hook(self._forget_network)

    @classmethod
    def lerobot_config(
        cls, config: ActConfig, inputs: Features, outputs: Features, device: str
    ) -> PreTrainedConfig:
        """Returns LeRobot's configuration."""
        shared: dict[str, Any] = dict(
            device=device,
            input_features=inputs,
            output_features=outputs,
            push_to_hub=False,
            chunk_size=config.chunk_size,
            n_action_steps=config.n_action_steps,
            dim_model=config.dim_model,
            n_heads=config.n_heads,
            dim_feedforward=config.dim_feedforward,
            n_encoder_layers=config.n_encoder_layers,
            n_decoder_layers=config.n_decoder_layers,
        )
        if config.vision_backbone == "keypoints":
            return KeypointActConfig(
                **shared,
                conv_channels=tuple(config.conv_channels),
                n_residual_blocks=config.n_residual_blocks,
                n_keypoints=config.n_keypoints,
                tokens_per_camera=config.tokens_per_camera,
            )
        return ACTConfig(
            **shared,
            use_vae=config.use_vae,
            n_vae_encoder_layers=config.n_vae_encoder_layers,
            latent_dim=config.latent_dim,
            kl_weight=config.kl_weight,
            dropout=config.dropout,
            vision_backbone=config.vision_backbone,
            pretrained_backbone_weights=config.pretrained_backbone_weights,
        )

    @classmethod
    def lerobot_processors(cls, config: Any, stats: dict[str, dict[str, Tensor]]) -> Processors:
        """Returns LeRobot's processors: the same of both networks."""
        return make_act_pre_post_processors(config, dataset_stats=stats)

    @classmethod
    def create(cls, features: Any, stats: Any, config: ActConfig, device: str) -> "ActPolicy":
        """Makes an untrained policy; see :func:`policies.create`."""
        policy = super().create(features, stats, config, device)
        norm = config.backbone_norm
        policy._train_batch_norm = norm == "batch" or (
            norm == "auto" and config.pretrained_backbone_weights is None
        )
        policy._mask_padding, policy._state_noise = config.mask_padding, config.state_noise
        return policy

    def act(
        self, observation: Observation, generators: Sequence[torch.Generator] | None = None
    ) -> np.ndarray:
        """Chooses the next actions; see :meth:`policies.base.Policy.act`."""
        if self.model.training:  # its weights are others at each call
            self._forget_network()
        return super().act(observation, generators)

    def predict(self, batch: dict[str, Tensor], generators: Sequence[torch.Generator] | None) -> Tensor:
        """Returns normalized actions; draws nothing."""
        del generators
        if self._network is None:
            network = self.model.model
            self._network = packed(network) if self.device.type == "cpu" else network
        actions, _ = self._network(self._inputs(batch))
        return actions

    def _forget_network(self, *_: Any) -> None:
        self._network = None

    def _inputs(self, batch: dict[str, Tensor]) -> dict[str, Any]:
        """Returns a batch as the network takes it, with its images in a list."""
        images = self.model.config.image_features
        return {**batch, OBS_IMAGES: [batch[key] for key in images]} if images else {**batch}

    def begin_training(self) -> None:
        """Readies the model for gradient steps."""
        if self._train_batch_norm:
            replace_modules(self.model, FrozenBatchNorm2d, _batch_norm)
        if isinstance(self.model, KeypointActPolicy):
            self.model.train()  # group normalization wants channels first, so channels last would be copied
        else:
            super().begin_training()

    def end_training(self) -> None:
        """Freezes the normalization of the backbone, as LeRobot has it."""
        replace_modules(self.model, nn.BatchNorm2d, _frozen_batch_norm)
        self._forget_network()
        super().end_training()

    def loss(self, batch: dict[str, Tensor]) -> Loss:
        """Returns the L1 distance of the actions, plus the weighted KL term (LeRobot's ACT, forward)."""
        config = self.model.config
        if self._state_noise:
            state = batch[OBS_STATE]
            batch = {**batch, OBS_STATE: state + self._state_noise * torch.randn_like(state)}
        # LeRobot makes its zeros on the CPU, and their copy waits for the GPU; a compiler moves them itself.
        elsewhere = self.device.type != "cpu" and not torch.compiler.is_compiling()
        with self.device if elsewhere else nullcontext():
            actions, (mean, log_variance) = self.model.model(self._inputs(batch))
        error = (batch[ACTION] - actions).abs()
        if self._mask_padding:
            counts = ~batch["action_is_pad"].unsqueeze(-1)
            terms = {"l1_loss": (error * counts).sum() / (counts.sum() * error.shape[-1]).clamp_min(1)}
        else:
            terms = {"l1_loss": error.mean()}
        loss = terms["l1_loss"]
        if log_variance is not None:
            divergence = -0.5 * (1 + log_variance - mean.pow(2) - log_variance.exp())
            terms["kld_loss"] = divergence.sum(-1).mean()
            loss = loss + config.kl_weight * terms["kld_loss"]
        return loss, {name: term.detach() for name, term in terms.items()}


def _batch_norm(frozen: FrozenBatchNorm2d) -> nn.BatchNorm2d:
    state = frozen.state_dict()
    weight = state["weight"]
    norm = nn.BatchNorm2d(len(weight), eps=frozen.eps, momentum=_NORM_MOMENTUM, device=weight.device)
    norm.load_state_dict(state, strict=False)
    return norm


def _frozen_batch_norm(norm: nn.BatchNorm2d) -> FrozenBatchNorm2d:
    frozen = FrozenBatchNorm2d(norm.num_features, eps=norm.eps)
    frozen.load_state_dict({key: torch.clone(value) for key, value in norm.state_dict().items()})
    return frozen.to(norm.weight.device)

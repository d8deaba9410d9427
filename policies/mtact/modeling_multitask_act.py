"""The multi-task policy of LeRobot's policy type ``multitask_act``, after BAKU (arXiv:2406.07539).

Shape legend: B = samples, C, H, W = an image, K = keypoints, S = tokens, D = width, T = actions of a chunk,
A = entries of an action.
"""

from typing import Any, cast

import torch
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_LANGUAGE, OBS_STATE
from torch import Tensor, nn

from envs.core.errors import PolicyError
from policies.act.modeling_keypoint_act import Block
from policies.lerobot_chunk_model import ChunkPolicy
from policies.mtact.configuration_multitask_act import MultitaskActConfig
from policies.mtact.decoders import FlowDecoder, RegressionDecoder
from policies.mtact.instruction_table import InstructionTable
from policies.mtact.sentence import VectorEncoder, WordsEncoder
from policies.mtact.vision import FilmKeypointBackbone, FilmResNet
from policies.mtact.wrong_instructions import WrongInstructions

SENTENCE = "observation.sentence"
"""Key of sentence vectors (B, D) that are known already, in place of ``observation.language``."""


class MultitaskActPolicy(ChunkPolicy):
    """The policy as LeRobot's commands use it.

    Args:
        config: Its configuration.

    Attributes:
        table: Instructions of the dataset that it is trained on, which its loss looks up by their index.
        wrong: What training asks wrongly for a share of the samples; None where that is 0.
    """

    config_class: Any = MultitaskActConfig
    name: Any = "multitask_act"

    def __init__(self, config: MultitaskActConfig, **_: Any) -> None:
        config.validate_features()
        super().__init__(config, MultitaskAct(config))
        self.table = InstructionTable()
        self.wrong: WrongInstructions | None = None

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], **_: Any) -> Tensor:
        """Returns normalized actions (B, T, A) of normalized inputs."""
        self.eval()
        return self.model(self.inputs(batch))

    def forward(self, batch: dict[str, Tensor], **_: Any) -> tuple[Tensor, dict[str, float]]:
        """Returns the mean error of the actions, those after the end of an episode included."""
        actions = batch[ACTION]
        is_own = torch.ones(len(actions), actions.shape[-1], dtype=torch.bool, device=actions.device)
        loss = self.model.errors(self.inputs(batch), actions, is_own).mean()
        return loss, {self.model.decoder.term: loss.item()}

    def inputs(self, batch: dict[str, Tensor]) -> dict[str, Any]:
        """Returns a batch as the network takes it, with its images in a list.

        Raises:
            PolicyError: if there is no instruction.
        """
        if OBS_LANGUAGE not in batch and SENTENCE not in batch:
            raise PolicyError(
                "The observation has no 'task', the instructions that policy 'mtact' reads. Give a list of "
                "one text per environment."
            )
        return super().inputs(batch)


class MultitaskAct(nn.Module):
    """The network.

    Args:
        config: Its sizes.
    """

    def __init__(self, config: MultitaskActConfig) -> None:
        super().__init__()
        cameras, dim = list(config.image_features.values()), config.dim_model
        state, action = cast(Any, config.robot_state_feature), cast(Any, config.action_feature)
        self.sentence = (
            VectorEncoder(config.sentence_size, dim, config.sentence_noise)
            if config.sentence_size
            else WordsEncoder(
                config.num_buckets,
                config.max_words,
                dim,
                config.n_heads,
                config.text_layers,
                config.word_dropout,
            )
        )
        self.backbones = nn.ModuleList(_backbone(config, camera.shape[0]) for camera in cameras)
        tokens = config.tokens_per_camera
        self.image_tokens = nn.ModuleList(nn.Linear(2 * config.n_keypoints, tokens * dim) for _ in cameras)
        self.state_token = nn.Linear(state.shape[0], dim)
        self.positions = nn.Parameter(0.1 * torch.randn(2 + tokens * len(cameras), dim))
        self.encoder = nn.ModuleList(
            Block(dim, config.n_heads, config.dim_feedforward) for _ in range(config.n_encoder_layers)
        )
        sizes = (config.chunk_size, action.shape[0], dim, config.n_heads, config.dim_feedforward)
        self.decoder = (
            FlowDecoder(*sizes, config.n_decoder_layers, config.num_inference_steps)
            if config.head == "flow"
            else RegressionDecoder(*sizes, config.n_decoder_layers)
        )

    def forward(
        self, batch: dict[str, Any], noise: Tensor | None = None, is_own: Tensor | None = None
    ) -> Tensor:
        """Predicts a chunk of normalized actions (B, T, A).

        Args:
            batch: ``observation.state`` (B, J), ``observation.images``, a list of (B, C, H, W), both
                normalized, and ``observation.language``, the numbers of the instructions.
            noise: Of ``head=flow``: (B, T, A).
            is_own: Of ``head=flow``: (B, A), false where an entry of the actions is padding.
        """
        memory = self.memory(batch)
        with torch.autocast(memory.device.type, enabled=False):
            return self.decoder(memory, noise, is_own)

    def errors(self, batch: dict[str, Any], actions: Tensor, is_own: Tensor) -> Tensor:
        """Returns the error of each entry of normalized actions (B, T, A).

        Args:
            batch: See :meth:`forward`.
            actions: (B, T, A).
            is_own: (B, A), false where an entry is padding; its errors are to be left out.
        """
        memory = self.memory(batch)
        with torch.autocast(memory.device.type, enabled=False):
            return self.decoder.errors(memory, actions, is_own)

    def memory(self, batch: dict[str, Any]) -> Tensor:
        """Returns the tokens (B, S, D) of an observation."""
        sentence = batch[SENTENCE] if SENTENCE in batch else self.sentence(batch[OBS_LANGUAGE])
        keypoints = [
            backbone(images, sentence)
            for images, backbone in zip(batch[OBS_IMAGES], self.backbones, strict=True)
        ]
        # In bf16, a coordinate would be off by up to 0.1 pixels of 96: the sentence and the convolutions
        # alone compute in it.
        with torch.autocast(sentence.device.type, enabled=False):
            tokens = [sentence.float().unsqueeze(1), self.state_token(batch[OBS_STATE]).unsqueeze(1)]
            for coordinates, project in zip(keypoints, self.image_tokens, strict=True):
                tokens.append(project(coordinates).unflatten(1, (-1, sentence.shape[1])))
            memory = torch.cat(tokens, 1) + self.positions
            for block in self.encoder:
                memory = block(memory)
        return memory


def _backbone(config: MultitaskActConfig, in_channels: int) -> nn.Module:
    dim = config.dim_model
    if config.vision_backbone == "keypoints":
        return FilmKeypointBackbone(in_channels, tuple(config.conv_channels), config.n_keypoints, dim)
    return FilmResNet(config.vision_backbone, in_channels, config.n_keypoints, dim)

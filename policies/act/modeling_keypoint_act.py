"""A small Action Chunking Transformer that learns on a CPU: LeRobot's policy type ``keypoint_act``.

It follows ACT (arXiv:2304.13705) without the variational encoder: tokens of the images and of the joints pass
an encoder, and one query per future action decodes them. The image tokens come from keypoints by spatial
softmax (arXiv:1504.00702) over convolutions with group normalization, in place of a ResNet-18's feature
map.

Shape legend: B = samples, C, H, W = an image, K = keypoints, S = tokens, D = width, T = actions of a chunk.
"""

from typing import Any, cast

import torch
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE
from torch import Tensor, nn
from torch.nn import functional

from policies.act.configuration_keypoint_act import KeypointActConfig
from policies.keypoint_backbone import KeypointBackbone
from policies.lerobot_chunk_model import ChunkPolicy


class KeypointActPolicy(ChunkPolicy):
    """The policy as LeRobot's commands use it.

    Args:
        config: Its configuration.
    """

    config_class: Any = KeypointActConfig
    name: Any = "keypoint_act"

    def __init__(self, config: KeypointActConfig, **_: Any) -> None:
        config.validate_features()
        super().__init__(config, KeypointAct(config))

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], **_: Any) -> Tensor:
        """Returns normalized actions (B, T, A) of normalized inputs."""
        self.eval()
        return self.model(self.inputs(batch))[0]

    def forward(self, batch: dict[str, Tensor], **_: Any) -> tuple[Tensor, dict[str, float]]:
        """Returns the L1 distance of the actions.

        Those after the end of an episode repeat its last and count too: the policy learns to hold still.
        """
        actions, _none = self.model(self.inputs(batch))
        loss = functional.l1_loss(actions, batch[ACTION])
        return loss, {"l1_loss": loss.item()}


class KeypointAct(nn.Module):
    """The network.

    Args:
        config: Its sizes.
    """

    def __init__(self, config: KeypointActConfig) -> None:
        super().__init__()
        cameras, dim = config.image_features, config.dim_model
        state, action = cast(Any, config.robot_state_feature), cast(Any, config.action_feature)
        self.backbones = nn.ModuleList(
            KeypointBackbone(
                shape.shape[0], config.conv_channels, config.n_keypoints, config.n_residual_blocks
            )
            for shape in cameras.values()
        )
        tokens = config.tokens_per_camera
        self.image_tokens = nn.ModuleList(nn.Linear(2 * config.n_keypoints, tokens * dim) for _ in cameras)
        self.state_token = nn.Linear(state.shape[0], dim)
        self.positions = nn.Parameter(0.1 * torch.randn(1 + tokens * len(cameras), dim))
        self.encoder = nn.ModuleList(
            Block(dim, config.n_heads, config.dim_feedforward) for _ in range(config.n_encoder_layers)
        )
        self.queries = nn.Parameter(0.5 * torch.randn(config.chunk_size, dim))
        self.decoder = nn.ModuleList(
            DecoderBlock(dim, config.n_heads, config.dim_feedforward, attends_to_itself=i > 0)
            for i in range(config.n_decoder_layers)
        )
        self.norm = nn.LayerNorm(dim)
        self.action_head = nn.Linear(dim, action.shape[0])

    def forward(self, batch: dict[str, Any]) -> tuple[Tensor, tuple[None, None]]:
        """Predicts a chunk of actions.

        Args:
            batch: ``observation.state`` (B, J) and ``observation.images``, a list of (B, C, H, W), both
                normalized.

        Returns:
            Normalized actions (B, T, A); and, as LeRobot's ACT, the parameters of a style variable, which
            this network does not have.
        """
        keypoints = [
            backbone(images) for images, backbone in zip(batch[OBS_IMAGES], self.backbones, strict=True)
        ]
        # In bf16, a coordinate would be off by up to 0.1 pixels of 96: only the convolutions compute in it.
        with torch.autocast(keypoints[0].device.type, enabled=False):
            return self.action_head(self.norm(self._decoded(batch[OBS_STATE], keypoints))), (None, None)

    def _decoded(self, state: Tensor, keypoints: list[Tensor]) -> Tensor:
        """Returns what the queries attend to in the joints (B, J) and keypoints (B, 2 K), (B, T, D)."""
        tokens = [self.state_token(state).unsqueeze(1)]
        for coordinates, project in zip(keypoints, self.image_tokens, strict=True):
            tokens.append(project(coordinates).unflatten(1, (-1, self.queries.shape[1])))
        memory = torch.cat(tokens, 1) + self.positions
        for block in self.encoder:
            memory = block(memory)
        decoded = self.queries.unsqueeze(0)
        for block in self.decoder:
            decoded = block(decoded, memory)
        return decoded


class Attention(nn.Module):
    """Multi-head attention of tokens (B, T, D) to a memory (B, S, D).

    Args:
        dim: Width.
        heads: Attention heads.
    """

    def __init__(self, dim: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query, self.key_value, self.out = (
            nn.Linear(dim, dim),
            nn.Linear(dim, 2 * dim),
            nn.Linear(dim, dim),
        )

    def forward(self, tokens: Tensor, memory: Tensor, is_key: Tensor | None = None) -> Tensor:
        """Returns what the tokens attend to, (B, T, D); tokens (1, T, D) are the same for every sample.

        Where ``is_key``, bool (B, S), is given, they attend to those places of the memory alone.
        """
        query = self._split(self.query(tokens)).expand(len(memory), -1, -1, -1)
        key, value = map(self._split, self.key_value(memory).chunk(2, -1))
        mask = None if is_key is None else is_key[:, None, None]
        attended = functional.scaled_dot_product_attention(query, key, value, attn_mask=mask)
        return self.out(attended.transpose(1, 2).flatten(2))

    def _split(self, x: Tensor) -> Tensor:
        return x.unflatten(-1, (self.heads, -1)).transpose(1, 2)


class Block(nn.Module):
    """A layer of the encoder: self-attention and feed-forward, each after its normalization.

    Args:
        dim: Width.
        heads: Attention heads.
        feedforward: Width of the feed-forward layer.
    """

    def __init__(self, dim: int, heads: int, feedforward: int) -> None:
        super().__init__()
        self.norm, self.attention = nn.LayerNorm(dim), Attention(dim, heads)
        self.feedforward = _feedforward(dim, feedforward)

    def forward(self, tokens: Tensor, is_key: Tensor | None = None) -> Tensor:
        """Returns the tokens (B, S, D) of the next layer; ``is_key`` as for :class:`Attention`."""
        normed = self.norm(tokens)
        tokens = tokens + self.attention(normed, normed, is_key)
        return tokens + self.feedforward(tokens)


class DecoderBlock(nn.Module):
    """A layer of the decoder: attention to the memory and feed-forward, each after its normalization.

    Args:
        dim: Width.
        heads: Attention heads.
        feedforward: Width of the feed-forward layer.
        attends_to_itself: Begin with self-attention. The first layer has no use for it: its queries are the
            same for every sample, so their self-attention would be a constant.
    """

    def __init__(self, dim: int, heads: int, feedforward: int, *, attends_to_itself: bool) -> None:
        super().__init__()
        self.self_norm = nn.LayerNorm(dim) if attends_to_itself else None
        self.self_attention = Attention(dim, heads) if attends_to_itself else None
        self.norm, self.attention = nn.LayerNorm(dim), Attention(dim, heads)
        self.feedforward = _feedforward(dim, feedforward)

    def forward(self, tokens: Tensor, memory: Tensor) -> Tensor:
        """Returns the tokens (B, T, D) of the next layer.

        ``memory`` is (B, S, D); of tokens that are the same for every sample one suffices, (1, T, D).
        """
        if self.self_norm is not None and self.self_attention is not None:
            normed = self.self_norm(tokens)
            tokens = tokens + self.self_attention(normed, normed)
        tokens = tokens + self.attention(self.norm(tokens), memory)
        return tokens + self.feedforward(tokens)


def _feedforward(dim: int, width: int) -> nn.Module:
    return nn.Sequential(
        nn.LayerNorm(dim), nn.Linear(dim, width), nn.ReLU(inplace=True), nn.Linear(width, dim)
    )

"""The network of OpenVLA, with the tensor names of its published checkpoints.

A language model reads the tokens of one image between its first token and the rest of the prompt, and answers
with one token per number of the action. Facts of the network are from the authors' code
(github.com/openvla/openvla, prismatic/extern/hf/modeling_prismatic.py).

Shapes: B = batch, L = tokens of a prompt, N = image patches, S = pixels a side, A = numbers of an action.
"""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from envs.core.errors import MissingExtraError, PolicyError
from envs.core.extras import install_command
from policies.normalization import HALF, IMAGENET

_SCALE, _GAMMA = ".scale_factor", ".gamma"
"""Name of a scaled layer's weight in checkpoints, and in timm."""


class VisionBackbone(nn.Module):
    """Patch features of DINOv2 and of SigLIP, side by side.

    Args:
        config: OpenVLA's configuration: ``timm_model_ids``, ``image_sizes``, ``timm_override_act_layers``.
    """

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__()
        import timm

        names, sizes = config["timm_model_ids"], config["image_sizes"]
        activations = config.get("timm_override_act_layers") or [None] * len(names)
        models: list[Any] = [
            timm.create_model(name, pretrained=False, num_classes=0, img_size=size, act_layer=activation)
            for name, size, activation in zip(names, sizes, activations, strict=True)
        ]
        self.featurizer: Any = models[0]
        self.fused_featurizer: Any = models[1] if len(models) > 1 else None
        self.size = sum(model.embed_dim for model in models)

    def forward(self, pixels: Tensor) -> Tensor:
        """Returns features (B, N, size) of pixels (B, 3 or 6, S, S)."""
        parts = [_patches(self.featurizer, pixels[:, :3])]
        if self.fused_featurizer is not None:
            parts.append(_patches(self.fused_featurizer, pixels[:, 3:]))
        return torch.cat(parts, 2)


def _patches(model: Any, pixels: Tensor) -> Tensor:
    """Returns the patches after the last block but one, without class and register tokens."""
    return model.get_intermediate_layers(pixels, n={len(model.blocks) - 2})[0]


class Projector(nn.Module):
    """From image features to embeddings of the language model.

    Args:
        vision_size: Width of the features.
        language_size: Width of the embeddings.
        fused: Whether the features are of two backbones, which adds a layer.
    """

    def __init__(self, vision_size: int, language_size: int, *, fused: bool) -> None:
        super().__init__()
        inner = 4 * vision_size if fused else language_size
        self.fc1 = nn.Linear(vision_size, inner)
        self.fc2 = nn.Linear(inner, language_size)
        self.fc3 = nn.Linear(language_size, language_size) if fused else None
        self.activation = nn.GELU()

    def forward(self, features: Tensor) -> Tensor:
        """Returns embeddings (B, N, language_size)."""
        embeddings = self.fc2(self.activation(self.fc1(features)))
        return embeddings if self.fc3 is None else self.fc3(self.activation(embeddings))


class OpenVla(nn.Module):
    """Vision backbone, projector and Llama.

    Args:
        config: OpenVLA's ``config.json``.

    Raises:
        MissingExtraError: if transformers or timm is not installed.
        PolicyError: if the configuration lacks something.
    """

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__()
        try:
            import timm  # noqa: F401
            from transformers import LlamaConfig, LlamaForCausalLM
        except ImportError as error:
            raise MissingExtraError(
                f"OpenVLA needs the package {error.name}: {install_command('vla')}."
            ) from error
        self.settings = dict(config)
        missing = [key for key in ("timm_model_ids", "image_sizes", "text_config") if key not in config]
        if missing:
            raise PolicyError(f"config.json is no configuration of OpenVLA: it has no {', '.join(missing)}.")
        text = LlamaConfig(**config["text_config"])
        self.vision_backbone = VisionBackbone(config)
        fused = self.vision_backbone.fused_featurizer is not None
        self.projector = Projector(self.vision_backbone.size, text.hidden_size, fused=fused)
        self.language_model: Any = LlamaForCausalLM(text)

    def embed(self, tokens: Tensor, pixels: Tensor) -> Tensor:
        """Returns the embeddings (B, N + L, width) of prompts (B, L) with the image after the first token."""
        words = self.language_model.get_input_embeddings()(tokens)
        image = self.projector(self.vision_backbone(pixels.to(self.projector.fc1.weight.dtype)))
        return torch.cat([words[:, :1], image.to(words.dtype), words[:, 1:]], 1)

    def forward(self, tokens: Tensor, attention: Tensor, pixels: Tensor) -> Tensor:
        """Returns the logits (B, L, vocabulary) of the prompts' tokens.

        Args:
            tokens: Prompts (B, L), padded at the end.
            attention: Which tokens are not padding (B, L).
            pixels: Images (B, 6, S, S); see :func:`pixels_of`.
        """
        embeddings = self.embed(tokens, pixels)
        patches = embeddings.shape[1] - tokens.shape[1]
        seen = torch.cat([attention[:, :1], attention.new_ones(len(tokens), patches), attention[:, 1:]], 1)
        logits = self.language_model(inputs_embeds=embeddings, attention_mask=seen, use_cache=False).logits
        return torch.cat([logits[:, :1], logits[:, patches + 1 :]], 1)

    @torch.no_grad()
    def answer(self, tokens: Tensor, pixels: Tensor, count: int) -> Tensor:
        """Returns the next tokens (B, count) of prompts of equal length, the likeliest each."""
        embeddings = self.embed(tokens, pixels)
        return self.language_model.generate(
            inputs_embeds=embeddings,
            attention_mask=torch.ones(embeddings.shape[:2], dtype=torch.long, device=embeddings.device),
            max_new_tokens=count,
            min_new_tokens=count,
            do_sample=False,
            pad_token_id=self.language_model.config.pad_token_id or 0,
        )


def pixels_of(images: Tensor, size: int, *, fused: bool = True) -> Tensor:
    """Returns images as OpenVLA sees them: ImageNet's normalization, then SigLIP's, in six channels.

    Args:
        images: (B, 3, H, W) from 0 to 1.
        size: Pixels a side, S.
        fused: Whether there are two backbones.

    Returns:
        (B, 6, S, S), or (B, 3, S, S) for one backbone.
    """
    resized = torch.nn.functional.interpolate(images, (size, size), mode="bicubic", antialias=True).clamp(
        0, 1
    )
    parts = []
    for mean, std in (IMAGENET, HALF)[: 2 if fused else 1]:
        shift, scale = (resized.new_tensor(value).view(3, 1, 1) for value in (mean, std))
        parts.append((resized - shift) / scale)
    return torch.cat(parts, 1)


def to_timm(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Returns a checkpoint's tensors by the names that timm gives them."""
    return {_swap(key, _SCALE, _GAMMA): value for key, value in tensors.items()}


def from_timm(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Returns the network's tensors by the names of published checkpoints."""
    return {_swap(key, _GAMMA, _SCALE): value for key, value in tensors.items()}


def _swap(key: str, old: str, new: str) -> str:
    return key.removesuffix(old) + new if key.startswith("vision_backbone.") and key.endswith(old) else key

"""Tensors of Octo's Flax parameters under the names and in the layout of :class:`policies.octo.network.Octo`.

Names are Flax's paths with slashes. A linear layer's kernel is (inputs, outputs) there, that of a convolution
(height, width, inputs, outputs), and attention keeps its heads apart.
"""

import re
from collections.abc import Callable, Mapping

from torch import Tensor

from envs.core.errors import PolicyError

_TRANSFORMER = "octo_transformer/BlockTransformer_0/Transformer_0/"
_HEAD = "heads_action/diffusion_model/"
_TEXT = "octo_transformer/task_tokenizers_language/hf_model/"
_LAYERS = {
    "LayerNorm_0": "norm1",
    "LayerNorm_1": "norm2",
    "MlpBlock_0/Dense_0": "fc1",
    "MlpBlock_0/Dense_1": "fc2",
}
_HEAD_LAYERS = {
    "cond_encoder/Dense_0": "time1",
    "cond_encoder/Dense_1": "time2",
    "reverse_network/Dense_0": "first",
    "reverse_network/Dense_1": "last",
}
_BLOCK_LAYERS = {"LayerNorm_0": "norm", "Dense_0": "fc1", "Dense_1": "fc2"}
_RULES: list[tuple[str, Callable[[re.Match[str]], str]]] = [
    (r"octo_transformer/task_language_projection", lambda m: "text_projection"),
    (r"octo_transformer/obs_(\w+)_projection", lambda m: f"projections.{m[1]}"),
    (r"octo_transformer/observation_tokenizers_(\w+)/SmallStem16_0/StdConv_(\d)",
     lambda m: f"stems.{m[1]}.convolutions.{m[2]}"),
    (r"octo_transformer/observation_tokenizers_(\w+)/SmallStem16_0/GroupNorm_(\d)",
     lambda m: f"stems.{m[1]}.norms.{m[2]}"),
    (r"octo_transformer/observation_tokenizers_(\w+)/SmallStem16_0/embedding",
     lambda m: f"stems.{m[1]}.embedding"),
    (_TRANSFORMER + r"encoder_norm", lambda m: "transformer.norm"),
    (_TRANSFORMER + r"encoderblock_(\d+)/MultiHeadDotProductAttention_0/(query|key|value|out)",
     lambda m: f"transformer.blocks.{m[1]}.{m[2]}"),
    (_TRANSFORMER + r"encoderblock_(\d+)/(LayerNorm_\d|MlpBlock_0/Dense_\d)",
     lambda m: f"transformer.blocks.{m[1]}.{_LAYERS[m[2]]}"),
    (_HEAD + r"(cond_encoder/Dense_[01]|reverse_network/Dense_[01])", lambda m: f"head.{_HEAD_LAYERS[m[1]]}"),
    (_HEAD + r"reverse_network/MLPResNetBlock_(\d+)/(LayerNorm_0|Dense_[01])",
     lambda m: f"head.blocks.{m[1]}.{_BLOCK_LAYERS[m[2]]}"),
]  # fmt: skip
_ALONE = [
    (r"octo_transformer/task_language_pos_embedding", lambda m: "text_positions"),
    (r"octo_transformer/obs_(\w+)_pos_embedding", lambda m: f"positions.{m[1]}"),
    (r"octo_transformer/readout_action_pos_embedding", lambda m: "readout_positions"),
    (_HEAD + r"time_preprocess/kernel", lambda m: "head.frequencies"),
]
_LEAVES = {"kernel": "weight", "scale": "weight", "bias": "bias"}


def from_flax(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Returns the tensors of the network, contiguous.

    Args:
        tensors: Flax's path, with slashes, to tensor.

    Raises:
        PolicyError: A name is none of Octo's.
    """
    found = {}
    for path, value in tensors.items():
        name, turned = _renamed(path, value)
        found[name] = turned.contiguous()
    shared = found.get("text_encoder.shared.weight")
    if shared is not None:  # transformers has it twice
        found["text_encoder.encoder.embed_tokens.weight"] = shared
    return found


def _renamed(path: str, value: Tensor) -> tuple[str, Tensor]:
    if path.startswith(_TEXT):
        return _of_text(path.removeprefix(_TEXT), value)
    for pattern, name in _ALONE:
        if match := re.fullmatch(pattern, path):
            return name(match), value
    layer, _, leaf = path.rpartition("/")
    for pattern, name in _RULES:
        match = re.fullmatch(pattern, layer)
        if match and leaf in _LEAVES:
            return f"{name(match)}.{_LEAVES[leaf]}", _turned(layer, leaf, value)
    raise PolicyError(
        f"The parameter '{path}' is none of an Octo that is built here: octo-small-1.5 and octo-base-1.5 are."
    )


def _turned(layer: str, leaf: str, value: Tensor) -> Tensor:
    if "MultiHeadDotProductAttention" in layer:
        if leaf == "bias":
            return value.flatten()
        return (value.flatten(0, 1) if layer.endswith("/out") else value.flatten(1)).T
    if leaf == "kernel":
        return value.permute(3, 2, 0, 1) if value.ndim == 4 else value.T
    return value


def _of_text(path: str, value: Tensor) -> tuple[str, Tensor]:
    layer, _, leaf = path.rpartition("/")
    name = layer.replace("/", ".")
    return f"text_encoder.{name}.weight", value.T if leaf == "kernel" else value

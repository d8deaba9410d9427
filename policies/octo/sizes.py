"""Sizes of an Octo network, from the ``config.json`` of its authors.

A part of the network is there a name of a class with its arguments (``ModuleSpec``).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from envs.core.errors import PolicyError

PATCH_PX = 16
"""Pixels a side of a patch of ``SmallStem16``."""

_TEXT_TOKENS = 16
"""Tokens that an instruction is padded or cut to (``text_processor`` of the published configurations)."""

_T5_BASE = {"d_model": 768, "d_kv": 64, "d_ff": 3072, "num_layers": 12, "num_heads": 12, "vocab_size": 32128}
"""``t5-base``, of which Octo has the encoder."""


@dataclass(frozen=True, kw_only=True, slots=True)
class OctoSizes:
    """Sizes of the parts.

    Attributes:
        cameras: Name of each image tokenizer to the pixels a side of its images, in order.
        width: Of a token, D.
        layers: Of the transformer.
        heads: Of its attention.
        mlp: Width inside its feed-forward parts.
        max_horizon: Most observations in time.
        readouts: Tokens that are read out at each of them.
        text: T5's configuration.
        text_tokens: Tokens of an instruction.
        stem: Channels of the image stem's convolutions.
        stem_out: Its channels at the end.
        repeats_text: Whether each observation has a copy of the instruction's tokens.
        right_groups: Whether tokens are attributed to their own group in the attention's rules. The first
            published networks attribute the first token of each group to the group before.
        action_dim: Numbers of an action, A.
        chunk_size: Actions that are predicted, H.
        head_width: Width inside the diffusion head.
        head_blocks: Its residual blocks.
        time_size: Width of the diffusion time's features.
        diffusion_steps: Steps of sampling.
        max_action: Largest normalized action.
    """

    cameras: dict[str, int]
    width: int
    layers: int
    heads: int
    mlp: int
    max_horizon: int
    readouts: int
    text: dict[str, Any]
    text_tokens: int
    stem: tuple[int, ...]
    stem_out: int
    repeats_text: bool
    right_groups: bool
    action_dim: int
    chunk_size: int
    head_width: int
    head_blocks: int
    time_size: int
    diffusion_steps: int
    max_action: float


def sizes_of(config: Mapping[str, Any]) -> OctoSizes:
    """Returns the sizes that a configuration names.

    Args:
        config: Octo's ``config.json`` with ``image_sizes``, name of the image tokenizer to pixels a side,
            which the converter adds.

    Raises:
        PolicyError: It is no configuration of Octo, or has parts that are not built here.
    """
    try:
        model = config["model"]
        tokenizers, head = model["observation_tokenizers"], model["heads"]["action"]
        _check(tokenizers, model["task_tokenizers"], head)
        transformer, diffusion = model["transformer_kwargs"], head["kwargs"]
        stem = next(iter(tokenizers.values()))["kwargs"]["encoder"]["kwargs"]
        return OctoSizes(
            cameras={name: int(config["image_sizes"][name]) for name in tokenizers},
            width=int(model["token_embedding_size"]),
            layers=int(transformer["num_layers"]),
            heads=int(transformer["num_attention_heads"]),
            mlp=int(transformer["mlp_dim"]),
            max_horizon=int(model["max_horizon"]),
            readouts=int(model["readouts"]["action"]),
            text=dict(config.get("text_config") or _T5_BASE),
            text_tokens=int(config.get("text_tokens") or _TEXT_TOKENS),
            stem=tuple(stem.get("features", (32, 96, 192, 384))),
            stem_out=int(stem.get("num_features", 512)),
            repeats_text=bool(model.get("repeat_task_tokens", False)),
            right_groups=bool(model.get("use_correct_attention", False)),
            action_dim=int(diffusion.get("action_dim", 7)),
            chunk_size=int(diffusion.get("action_horizon", diffusion.get("pred_horizon", 1))),
            head_width=int(diffusion.get("hidden_dim", 256)),
            head_blocks=int(diffusion.get("num_blocks", 3)),
            time_size=int(diffusion.get("time_dim", 32)),
            diffusion_steps=int(diffusion.get("diffusion_steps", 20)),
            max_action=float(diffusion.get("max_action", 5.0)),
        )
    except (KeyError, TypeError, AttributeError, StopIteration) as error:
        raise PolicyError(
            f"config.json is no configuration of a converted Octo ({error!r}). Convert the published folder "
            "with policies/octo/convert.py."
        ) from error


def _check(tokenizers: Mapping[str, Any], texts: Mapping[str, Any], head: Mapping[str, Any]) -> None:
    encoders = {each["kwargs"]["encoder"]["name"] for each in tokenizers.values()}
    wrong = sorted(encoders - {"SmallStem16"})
    wrong += [] if set(texts) == {"language"} else [f"task tokenizers {sorted(texts)}"]
    wrong += [] if head["name"] == "DiffusionActionHead" else [head["name"]]
    wrong += ["use_map=True"] if head["kwargs"].get("use_map") else []
    if wrong:
        raise PolicyError(
            f"This Octo has {', '.join(wrong)}. Built here are the parts of octo-small-1.5 and "
            "octo-base-1.5: SmallStem16, one instruction, DiffusionActionHead without attention pooling."
        )

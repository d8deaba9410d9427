"""Keys of a policy that are typed and change nothing beside its other settings."""

from collections.abc import Mapping, Sequence
from typing import Any

from envs.core.errors import ConfigError
from roboverse_learn.config.command_line_keys import at

_OF_PEFT = "policy.peft."
_METHOD = f"{_OF_PEFT}method_type"
_OF_KEYPOINTS = [f"policy.{name}" for name in ("conv_channels", "n_residual_blocks")]
_OF_SCRATCH = [f"policy.{name}" for name in ("text_layers", "max_words", "num_buckets", "word_dropout")]


def check_idle_keys(values: Mapping[str, Any], keys: Sequence[str]) -> None:
    """Checks that no typed key of a policy waits for another one.

    One that is typed at its default counts: the policy itself cannot tell it from one that is absent.

    Args:
        values: Values of a command.
        keys: Full names of the keys that are typed.

    Raises:
        ConfigError: One of them has no effect.
    """
    waiting: dict[str, str] = {}
    if at(values, "policy.head") == "regression":
        waiting["policy.num_inference_steps"] = "policy.head=flow"
    if str(at(values, "policy.vision_backbone")).startswith("resnet"):
        waiting |= dict.fromkeys(_OF_KEYPOINTS, "policy.vision_backbone=keypoints")
    encoder = at(values, "policy.text_encoder")
    if encoder == "scratch":
        waiting["policy.sentence_noise"] = "policy.text_encoder=<folder>"
    elif encoder:
        waiting |= dict.fromkeys(_OF_SCRATCH, "policy.text_encoder=scratch")
    if not at(values, _METHOD):
        of_peft = [key for key in keys if key.startswith(_OF_PEFT) and key != _METHOD]
        waiting |= dict.fromkeys(of_peft, "peft.method_type=LORA")
    if idle := [key for key in keys if key in waiting]:
        raise ConfigError(
            f"{idle[0].removeprefix('policy.')} alone has no effect: add {waiting[idle[0]]}, or leave it out."
        )

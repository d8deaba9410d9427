"""Small backbones without pretrained weights, for LeRobot's VLAs on a machine without the hub.

``python -m roboverse_learn.training.imitation.small_backbone out=backbones/smolvla suite=grasp/many`` writes
a folder with the configuration of a few million parameters and a tokenizer that has learned the wordings of
the tasks, and prints the keys with which ``roboverse train`` takes it. Weights begin at random: what is
trained on it is the policy's architecture from scratch.
"""

import logging
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from envs.core.arguments import run_program
from envs.core.errors import ConfigError, unknown_name
from envs.spec import EnvSpec
from envs.tasks.suites import suite_tasks
from policies.zoo.preflight import check_type_packages

logger = logging.getLogger(__name__)

_COMMAND = "python -m roboverse_learn.training.imitation.small_backbone"

_VOCABULARY = 1024
_PATCH_PX = 8  # a grocery of the grasping sets is about as large at 128 pixels
_LR = 5e-4  # from scratch; LeRobot's are those of fine-tuning
_SMOLVLM_IMAGE_TOKENS = {
    "image_token": "<image>",
    "fake_image_token": "<fake_token_around_image>",
    "global_image_token": "<global-img>",
    "end_of_utterance_token": "<end_of_utterance>",
}
_SMOLVLM_TOKENS = ["<pad>", "<s>", "</s>", *_SMOLVLM_IMAGE_TOKENS.values()]
# The end's id must not be 2: CLIP then reads a sentence's vector where its largest id is, not at its end.
_CLIP_TOKENS = ["<|startoftext|>", "<|endoftext|>", "<|pad|>"]


@dataclass(frozen=True, kw_only=True, slots=True)
class BackboneSettings:
    """Settings of the command.

    Attributes:
        type: LeRobot's policy type, smolvla or multi_task_dit.
        out: Folder to write; that of multi_task_dit must have "clip" in its name, which LeRobot asks for.
        suite: Suite whose wordings the tokenizer learns; tasks are those of tasks beside it.
        tasks: Tasks whose wordings it learns.
        image_px: Pixels a side of the images that the network sees, a multiple of 32.
    """

    type: str = "smolvla"
    out: Path = Path("backbones/smolvla")
    suite: str = ""
    tasks: tuple[str, ...] = ()
    image_px: int = 128


def main(words: Sequence[str] | None = None) -> int:
    """Writes a backbone and prints the keys of a policy on it; returns the exit code."""

    def run(settings: BackboneSettings) -> None:
        logger.info("roboverse train policy=lerobot type=%s %s", settings.type, " ".join(keys_of(settings)))

    return run_program(_COMMAND, BackboneSettings, run, words)


def keys_of(settings: BackboneSettings) -> list[str]:
    """Writes a backbone; returns the words with which ``roboverse train`` takes it.

    Raises:
        ConfigError: A setting is out of range, there is no task, or the folder exists.
        MissingExtraError: A package of the policy type is not installed.
    """
    if settings.type not in _WRITERS:
        raise unknown_name("type with a small backbone", settings.type, list(_WRITERS))
    if settings.image_px < 32 or settings.image_px % 32:
        raise ConfigError(f"image_px must be a multiple of 32, given {settings.image_px}.")
    if settings.out.exists():
        raise ConfigError(f"out={settings.out} exists. Name a new folder, or remove it.")
    if settings.type == "multi_task_dit" and "clip" not in str(settings.out).lower():
        raise ConfigError(f"LeRobot takes a folder with 'clip' in its name, given out={settings.out}.")
    tasks = [*(suite_tasks(settings.suite) if settings.suite else ()), *settings.tasks]
    if not tasks:
        raise ConfigError(
            "Name the tasks whose wordings the tokenizer learns: suite=<name> or tasks=[<name>]."
        )
    check_type_packages(settings.type)
    values = _WRITERS[settings.type](settings.out, _wordings(tasks), settings.image_px)
    return [f"policy.{key}={_word(value)}" for key, value in values.items()]


def _wordings(tasks: Sequence[str]) -> list[str]:
    """Returns the instructions of tasks and the known wordings of their banks."""
    texts: dict[str, None] = {}
    for name in tasks:
        task = EnvSpec(task=name).make_task()
        texts |= dict.fromkeys([*task.instructions, *task.wordings(task.description).known])
    return list(texts)


def _smolvla(folder: Path, texts: list[str], image_px: int) -> dict[str, Any]:
    sizes = dict(
        scale_factor=2,
        vision_config=dict(
            image_size=image_px, patch_size=_PATCH_PX, hidden_size=192, intermediate_size=768,
            num_hidden_layers=4, num_attention_heads=3,
        ),
        text_config=dict(
            vocab_size=_VOCABULARY, hidden_size=256, intermediate_size=1024, head_dim=64,
            num_hidden_layers=4, num_attention_heads=4, num_key_value_heads=2,
        ),
    )  # fmt: skip
    write_smolvlm(folder, sizes, texts, vocabulary=_VOCABULARY)
    return {
        "vlm_model_name": folder, "num_vlm_layers": 4, "freeze_vision_encoder": False,
        "train_expert_only": False, "resize_imgs_with_padding": [image_px, image_px], "chunk_size": 20,
        "n_action_steps": 10, "optimizer_lr": _LR,
    }  # fmt: skip


def write_smolvlm(
    folder: Path,
    sizes: Mapping[str, Any],
    texts: list[str],
    *,
    weights: bool = False,
    vocabulary: int = 320,
) -> None:
    """Writes a SmolVLM with a tokenizer and a processor, as ``policy.vlm_model_name`` names one.

    Args:
        folder: Where.
        sizes: Of the network: ``scale_factor``, ``vision_config`` and ``text_config``.
        texts: Sentences that the tokenizer learns; it is byte-level, so it has every word.
        weights: Whether random weights are written too.
        vocabulary: Tokens of the tokenizer, special ones included.
    """
    import transformers

    vocabulary = min(vocabulary, sizes["text_config"]["vocab_size"])
    pad, start, end, *_ = _SMOLVLM_TOKENS
    tokenizer = transformers.PreTrainedTokenizerFast(
        tokenizer_object=_tokenizer(texts, vocabulary, _SMOLVLM_TOKENS),
        pad_token=pad,
        bos_token=start,
        eos_token=end,
        extra_special_tokens=dict(_SMOLVLM_IMAGE_TOKENS),
    )
    llama = {"model_type": "llama", "pad_token_id": 0, "max_position_embeddings": 8192}
    config = transformers.SmolVLMConfig(
        scale_factor=sizes["scale_factor"],
        image_token_id=_SMOLVLM_TOKENS.index("<image>"),
        pad_token_id=0,
        vision_config=dict(sizes["vision_config"]),
        text_config=sizes["text_config"] | llama,
    )
    (transformers.SmolVLMForConditionalGeneration(config) if weights else config).save_pretrained(folder)
    image_px, patch_px = (sizes["vision_config"][key] for key in ("image_size", "patch_size"))
    edge = {"longest_edge": image_px}
    sampling = {"fps": 1, "max_frames": 1}
    transformers.SmolVLMProcessor(
        transformers.SmolVLMImageProcessor(size=edge, max_image_size=edge, do_image_splitting=False),
        tokenizer,
        transformers.SmolVLMVideoProcessor(size=edge, max_image_size=edge, video_sampling=sampling),
        image_seq_len=(image_px // patch_px // sizes["scale_factor"]) ** 2,
    ).save_pretrained(folder)


def _multi_task_dit(folder: Path, texts: list[str], image_px: int) -> dict[str, Any]:
    from transformers import CLIPConfig, CLIPModel

    tokenizer = _clip_tokenizer(texts)
    start, end, pad = (tokenizer.convert_tokens_to_ids(token) for token in _CLIP_TOKENS)
    shared = dict(hidden_size=192, intermediate_size=768, num_hidden_layers=4, num_attention_heads=3)
    config = CLIPConfig(
        text_config=dict(
            **shared, vocab_size=len(tokenizer), max_position_embeddings=77, bos_token_id=start,
            eos_token_id=end, pad_token_id=pad,
        ),
        vision_config=dict(**shared, image_size=image_px, patch_size=_PATCH_PX),
        projection_dim=192,
    )  # fmt: skip
    CLIPModel(config).save_pretrained(folder)  # LeRobot reads weights, which are random ones
    tokenizer.save_pretrained(folder)
    return {
        "vision_encoder_name": folder, "text_encoder_name": folder, "vision_encoder_lr_multiplier": 1.0,
        "image_resize_shape": [image_px, image_px], "image_crop_shape": [image_px, image_px],
        "hidden_dim": 256, "num_layers": 4, "num_heads": 4, "horizon": 32, "n_action_steps": 10,
        "objective": "flow_matching", "num_integration_steps": 10, "drop_n_last_frames": 0, "dropout": 0.0,
        "optimizer_lr": _LR,
    }  # fmt: skip


def _clip_tokenizer(texts: list[str]) -> Any:
    from tokenizers.processors import TemplateProcessing  # pyright: ignore[reportMissingImports]
    from transformers import PreTrainedTokenizerFast

    tokenizer = _tokenizer(texts, _VOCABULARY, _CLIP_TOKENS)
    start, end, pad = _CLIP_TOKENS
    tokenizer.post_processor = TemplateProcessing(
        single=f"{start} $A {end}",
        special_tokens=[(token, tokenizer.token_to_id(token)) for token in (start, end)],
    )
    return PreTrainedTokenizerFast(tokenizer_object=tokenizer, pad_token=pad, bos_token=start, eos_token=end)


def _tokenizer(texts: list[str], vocabulary: int, special: list[str]) -> Any:
    """Returns a tokenizer that has learned texts, with special tokens before all others."""
    from tokenizers import ByteLevelBPETokenizer, Tokenizer  # pyright: ignore[reportMissingImports]

    learned = ByteLevelBPETokenizer(lowercase=True)
    learned.train_from_iterator(texts, vocabulary, min_frequency=0, special_tokens=special)
    return Tokenizer.from_str(learned.to_str())


def _word(value: Any) -> str:
    return str(value).replace(" ", "").lower() if isinstance(value, bool | list) else str(value)


_WRITERS: Mapping[str, Callable[[Path, list[str], int], dict[str, Any]]] = {
    "smolvla": _smolvla,
    "multi_task_dit": _multi_task_dit,
}

if __name__ == "__main__":
    sys.exit(main())

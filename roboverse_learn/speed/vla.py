"""A gradient step of SmolVLA at its real size, against LeRobot's: ``roboverse speed vla``.

Both train the same network from the same random weights on the same frames, whole or with LoRA. LeRobot's
side is what ``lerobot-train`` does once it has a batch on the device: processors, forward and backward pass,
clipping, its own optimizer, and the loss as a number; in fp32 with products in tf32, its default, and with
``accelerate``'s bf16. Ours is bf16, the default here, on a GPU with ``train.compile=true``, which is not. No
weights are fetched: the backbone is made from its published sizes.
"""

import itertools
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch

from envs.core.errors import SimulatorError
from roboverse_learn.speed import training
from roboverse_learn.speed.harness import (
    Goal,
    Measurement,
    Settings,
    cuda_wait,
    in_turns,
    measurement,
    program,
    repeat,
)
from roboverse_learn.speed.training import CAMERA, Frames, Side

GOAL = 1.3
SAME_LOSS = 0.05
"""Largest relative difference of the first losses: ours is computed in bf16 and LeRobot's in fp32."""

INSTRUCTION = "pick up the red cube"
_SPECIAL = (
    "<pad>",
    "<s>",
    "</s>",
    "<image>",
    "<fake_token_around_image>",
    "<global-img>",
    "<end_of_utterance>",
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Backbone:
    """Sizes of a SmolVLM.

    The defaults are those of HuggingFaceTB/SmolVLM2-500M-Video-Instruct (config.json), SmolVLA's backbone.
    """

    image_px: int = 512
    patch_px: int = 16
    scale_factor: int = 4
    vision_size: int = 768
    vision_layers: int = 12
    vision_heads: int = 12
    text_size: int = 960
    text_inner: int = 2560
    text_layers: int = 32
    text_heads: int = 15
    text_kv_heads: int = 5
    vocabulary: int = 49_280


REAL = Backbone()
TINY = Backbone(
    image_px=64, scale_factor=2, vision_size=32, vision_layers=1, vision_heads=2, text_size=64,
    text_inner=128, text_layers=2, text_heads=4, text_kv_heads=2, vocabulary=320,
)  # fmt: skip

GPU = training.Scale(batch_size=64, image_size=256, num_frames=2000, steps=5, turns=5, compared=2)
CPU = training.Scale(batch_size=2, image_size=64, num_frames=16, steps=1, turns=2, compared=2)


@dataclass(frozen=True, kw_only=True, slots=True)
class VlaSettings(Settings):
    """Compares a gradient step of SmolVLA to LeRobot's.

    Attributes:
        parts: full, full_bf16, lora, lora_bf16: of LeRobot in fp32 and in bf16.
        device: ``auto``, ``cpu``, ``cuda``.
        compile: Whether our side compiles the network's blocks; None does so on a GPU.
        out: JSON file for the measurements.
    """

    device: str = "auto"
    compile: bool | None = None


def parts(settings: VlaSettings) -> Mapping[str, Callable[[], Measurement]]:
    """Returns what is measured."""
    from policies.zoo.preflight import check_packages
    from roboverse_learn.training.device import resolve_device

    check_packages("roboverse speed vla", "transformers", "peft", "num2words")
    device = resolve_device(settings.device)
    compile = device == "cuda" if settings.compile is None else settings.compile
    return {
        f"{name}{suffix}": partial(measure, name, device, bf16=bool(suffix), compile=compile)
        for name in ("full", "lora")
        for suffix in ("", "_bf16")
    }


def write_backbone(folder: Path, sizes: Backbone, words: list[str], *, weights: bool) -> None:
    """Writes a SmolVLM with a tokenizer and a processor, as ``policy.vlm_model_name`` names one.

    Args:
        folder: Where.
        sizes: Of the network.
        words: Sentences that the tokenizer learns; it is byte-level, so it has every word.
        weights: Whether random weights are written too.
    """
    from tokenizers import Tokenizer, decoders, models, normalizers, pre_tokenizers, trainers  # pyright: ignore[reportMissingImports]
    from transformers import (
        PreTrainedTokenizerFast,
        SmolVLMConfig,
        SmolVLMForConditionalGeneration,
        SmolVLMImageProcessor,
        SmolVLMProcessor,
        SmolVLMVideoProcessor,
    )

    learned = Tokenizer(models.BPE())
    learned.normalizer = normalizers.Lowercase()
    learned.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    learned.decoder = decoders.ByteLevel()
    learned.train_from_iterator(
        words,
        trainers.BpeTrainer(
            vocab_size=min(320, sizes.vocabulary), special_tokens=list(_SPECIAL),
            initial_alphabet=pre_tokenizers.ByteLevel.alphabet(),
        ),
    )  # fmt: skip
    named = ("image_token", "fake_image_token", "global_image_token", "end_of_utterance_token")
    tokenizer = PreTrainedTokenizerFast(
        tokenizer_object=learned, pad_token="<pad>", bos_token="<s>", eos_token="</s>",
        extra_special_tokens=dict(zip(named, _SPECIAL[3:], strict=True)),
    )  # fmt: skip
    config = SmolVLMConfig(
        scale_factor=sizes.scale_factor, image_token_id=_SPECIAL.index("<image>"), pad_token_id=0,
        vision_config=dict(
            hidden_size=sizes.vision_size, intermediate_size=4 * sizes.vision_size, image_size=sizes.image_px,
            num_hidden_layers=sizes.vision_layers, num_attention_heads=sizes.vision_heads,
            patch_size=sizes.patch_px,
        ),
        text_config=dict(
            model_type="llama", hidden_size=sizes.text_size, intermediate_size=sizes.text_inner,
            num_hidden_layers=sizes.text_layers, num_attention_heads=sizes.text_heads,
            num_key_value_heads=sizes.text_kv_heads, head_dim=sizes.text_size // sizes.text_heads,
            vocab_size=sizes.vocabulary, pad_token_id=0, max_position_embeddings=8192,
        ),
    )  # fmt: skip
    (SmolVLMForConditionalGeneration(config) if weights else config).save_pretrained(folder)
    edge = {"longest_edge": sizes.image_px}
    patches = (sizes.image_px // sizes.patch_px // sizes.scale_factor) ** 2
    SmolVLMProcessor(
        SmolVLMImageProcessor(size=edge, max_image_size=edge, do_image_splitting=False),
        tokenizer,
        SmolVLMVideoProcessor(size=edge, max_image_size=edge, video_sampling={"fps": 1, "max_frames": 1}),
        image_seq_len=patches,
    ).save_pretrained(folder)


def measure(name: str, device: str, *, bf16: bool, compile: bool = False) -> Measurement:
    """Compares the steps of the whole network, or of adapters, each side with a network of its own.

    Args:
        name: ``full`` or ``lora``.
        device: Torch device.
        bf16: Whether LeRobot's side computes in bf16.
        compile: Whether our side compiles the network's blocks.

    Raises:
        SimulatorError: if the losses of the first steps differ by more than :data:`SAME_LOSS`.
    """
    on_gpu = device == "cuda"
    scale = GPU if on_gpu else CPU
    with tempfile.TemporaryDirectory() as folder:
        make = _maker(Path(folder), name, REAL if on_gpu else TINY, device)
        sides = _our_step(make(), scale, compile=compile), _lerobot_step(make(), scale, bf16=bf16)
    losses = [[float(take(step)) for take in sides] for step in range(scale.compared)]
    apart = max(abs(ours - theirs) / abs(theirs) for ours, theirs in losses)
    if not apart <= SAME_LOSS:
        raise SimulatorError(f"The losses differ by {apart:.1%}: the two do not train the same network.")
    counters = itertools.count(scale.compared), itertools.count(scale.compared)
    ours, theirs = (
        repeat(partial(_next, side, counter), scale.steps)
        for side, counter in zip(sides, counters, strict=True)
    )
    seconds = in_turns(ours, theirs, scale.turns, wait=cuda_wait(device))
    title = (
        f"training step of SmolVLA ({name}), batch {scale.batch_size}, on {device}, LeRobot in "
        f"{'bf16' if bf16 else 'fp32'} / ours in bf16{', compiled' if compile else ''} (losses differ by "
        f"{apart:.2%})"
    )
    goal = Goal(GOAL, applies=on_gpu) if not bf16 else Goal()
    return measurement(title, seconds, goal, units=scale.steps)


def _next(side: Side, steps: itertools.count) -> None:
    side(next(steps))


def _maker(folder: Path, name: str, sizes: Backbone, device: str) -> Callable[[], Any]:
    """Returns what makes a policy, each time with the same weights."""
    import policies
    from policies.zoo.config import LeRobotConfig, PeftConfig
    from roboverse_learn.training.imitation.estimate import plain_stats

    write_backbone(folder / "vlm", sizes, [INSTRUCTION], weights=False)
    image = {"dtype": "video", "shape": (64, 64, 3), "names": ["height", "width", "channels"]}
    vector = {"dtype": "float32", "shape": (9,), "names": None}
    features = {CAMERA: image, "observation.state": vector, "action": vector}
    settings = {
        "vlm_model_name": str(folder / "vlm"), "num_vlm_layers": min(16, sizes.text_layers),
        "resize_imgs_with_padding": [sizes.image_px, sizes.image_px], "freeze_vision_encoder": False,
        "train_expert_only": False,
    }  # fmt: skip
    whole = LeRobotConfig(type="smolvla", settings=settings)

    def create(config: LeRobotConfig) -> Any:
        return policies.create("lerobot", features, plain_stats(features), config, device)

    if name == "full":
        return partial(create, whole)
    create(whole).save(folder / "base")
    return partial(create, LeRobotConfig(path=str(folder / "base"), peft=PeftConfig(method_type="LORA")))


def _batch(frames: Frames, step: int, count: int) -> dict[str, Any]:
    return frames.batch(step) | {"task": [INSTRUCTION] * count}


def _our_step(policy: Any, scale: training.Scale, *, compile: bool) -> Side:
    """Returns a step of :mod:`roboverse_learn.training.imitation.train`."""
    from policies.compilation import compile_objective
    from roboverse_learn.training.config import TrainConfig
    from roboverse_learn.training.imitation.train import make_optimizer

    frames = Frames(scale, policy.delta_indices, str(policy.device))
    policy.begin_training()
    objective = policy.objective()
    if compile:
        compile_objective(objective)
    config = policy.training_config(TrainConfig())
    optimizer = make_optimizer(policy, config)

    def take(step: int) -> Any:
        torch.manual_seed(step)
        with torch.autocast(policy.device.type, torch.bfloat16):
            loss, _terms = objective(_batch(frames, step, scale.batch_size))
        _update(loss, policy, optimizer, config.grad_clip)
        return loss.detach()

    return take


def _lerobot_step(policy: Any, scale: training.Scale, *, bf16: bool) -> Side:
    """Returns the step of ``lerobot.scripts.lerobot_train.update_policy``."""
    frames = Frames(scale, policy.delta_indices, str(policy.device))
    policy.model.train()
    preset = policy.network.config.get_optimizer_preset()
    optimizer = preset.build([each for each in policy.model.parameters() if each.requires_grad])

    def take(step: int) -> Any:
        torch.manual_seed(step)
        batch = _batch(frames, step, scale.batch_size)
        batch[CAMERA] = batch[CAMERA].float() / 255.0  # as its dataset returns images
        batch = policy.preprocessor(batch)
        with _tf32():
            with torch.autocast(policy.device.type, torch.bfloat16) if bf16 else nullcontext():
                loss, _terms = policy.model.forward(batch)
            _update(loss, policy, optimizer, preset.grad_clip_norm)
        loss.item()
        return loss.detach()

    return take


@contextmanager
def _tf32() -> Iterator[None]:
    """While it lasts, fp32 matrices are multiplied in tf32 on a GPU, as ``lerobot-train`` sets it."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("high")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


def _update(loss: Any, policy: Any, optimizer: Any, grad_clip: float) -> None:
    loss.backward()
    torch.nn.utils.clip_grad_norm_(policy.model.parameters(), grad_clip)
    optimizer.step()
    optimizer.zero_grad()


if __name__ == "__main__":
    sys.exit(program("vla", VlaSettings, parts))

"""A gradient step of SmolVLA at its real size, against LeRobot's: ``roboverse speed vla``.

Both train the same network from the same random weights on the same frames, whole or with LoRA. LeRobot's
side is what ``lerobot-train`` does once it has a batch on the device: processors, forward and backward pass,
clipping, its own optimizer, and the loss as a number; in fp32 with products in tf32, its default, and with
``accelerate``'s bf16. Ours is bf16, the default here, on a GPU with ``train.compile=true``, which is not. No
weights are fetched: the backbone is made from its published sizes.
"""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, override

from roboverse_learn.speed.harness import NO_GOAL, Goal, Measurement, part, scaled
from roboverse_learn.speed.training import GradientSteps, plain_features
from roboverse_learn.training.imitation.small_backbone import write_smolvlm

REAL: Mapping[str, Any] = dict(
    scale_factor=4,
    vision_config=dict(
        image_size=512, patch_size=16, hidden_size=768, intermediate_size=3072,
        num_hidden_layers=12, num_attention_heads=12,
    ),
    text_config=dict(
        vocab_size=49_280, hidden_size=960, intermediate_size=2560, head_dim=64,
        num_hidden_layers=32, num_attention_heads=15, num_key_value_heads=5,
    ),
)  # fmt: skip
"""Sizes of HuggingFaceTB/SmolVLM2-500M-Video-Instruct (config.json), SmolVLA's backbone."""

TINY: Mapping[str, Any] = dict(
    scale_factor=2,
    vision_config=dict(
        image_size=64, patch_size=16, hidden_size=32, intermediate_size=128,
        num_hidden_layers=1, num_attention_heads=2,
    ),
    text_config=dict(
        vocab_size=320, hidden_size=64, intermediate_size=128, head_dim=16,
        num_hidden_layers=2, num_attention_heads=4, num_key_value_heads=2,
    ),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True)
class Vla(GradientSteps):
    """Compares a gradient step of SmolVLA to LeRobot's.

    Attributes:
        parts: full, full_bf16, lora, lora_bf16: of LeRobot in fp32 and in bf16.
        compile: Whether our side compiles the network's blocks; None does so on a GPU.
    """

    instruction: ClassVar = "pick up the red cube"
    same_loss: ClassVar = 0.05  # ours is computed in bf16 and LeRobot's in fp32

    batch_size: int = scaled(gpu=64, cpu=2)
    num_frames: int = scaled(gpu=2000, cpu=16)
    steps: int = scaled(gpu=5, cpu=1)
    compared: int = scaled(gpu=2, cpu=2)
    compile: bool | None = None

    @override
    def prepare(self) -> None:
        from policies.zoo.preflight import check_packages

        check_packages("roboverse speed vla", "transformers", "peft", "num2words")

    @part("full", "full", bf16=False)
    @part("full_bf16", "full", bf16=True)
    @part("lora", "lora", bf16=False)
    @part("lora_bf16", "lora", bf16=True)
    def step(self, name: str, *, bf16: bool) -> Measurement:
        """Compares the steps of the whole network, or of adapters, each side with a network of its own."""
        on_gpu = self.on_gpu
        compile = on_gpu if self.compile is None else self.compile
        with tempfile.TemporaryDirectory() as folder:
            make = self._maker(Path(folder), name, REAL if on_gpu else TINY)
            first, second = make(), make()
        preset = second.network.config.get_optimizer_preset()
        optimizer = preset.build([each for each in second.model.parameters() if each.requires_grad])
        theirs = self.lerobot_step(second, optimizer, preset.grad_clip_norm, bf16=bf16)
        sides = (self.our_step(first, compile=compile), theirs)
        title = (
            f"training step of SmolVLA ({name}), batch {self.batch_size}, on {self.device}, LeRobot in "
            f"{'bf16' if bf16 else 'fp32'} / ours in bf16{', compiled' if compile else ''} (losses differ by "
            f"{self.losses_apart(sides):.2%})"
        )
        goal = NO_GOAL if bf16 else Goal(1.3, applies=on_gpu)
        return self.compare(title, *sides, goal, calls=self.steps)

    def _maker(self, folder: Path, name: str, sizes: Mapping[str, Any]) -> Callable[[], Any]:
        """Returns what makes a policy, each time with the same weights."""
        import policies
        from policies.zoo.config import LeRobotConfig, PeftConfig
        from roboverse_learn.training.imitation.estimate import plain_stats

        write_smolvlm(folder / "vlm", sizes, [self.instruction])
        features = plain_features(64)
        settings = {
            "vlm_model_name": str(folder / "vlm"),
            "num_vlm_layers": min(16, sizes["text_config"]["num_hidden_layers"]),
            "resize_imgs_with_padding": [sizes["vision_config"]["image_size"]] * 2,
            "freeze_vision_encoder": False,
            "train_expert_only": False,
        }

        def create(config: LeRobotConfig) -> Any:
            return policies.create("lerobot", features, plain_stats(features), config, self.device)

        whole = LeRobotConfig(type="smolvla", settings=settings)
        if name == "full":
            return partial(create, whole)
        create(whole).save(folder / "base")
        return partial(create, LeRobotConfig(path=str(folder / "base"), peft=PeftConfig(method_type="LORA")))

"""Configuration of training; data only, imported by every command."""

import math
from dataclasses import dataclass, fields
from typing import Literal

from envs.core.errors import ConfigError
from envs.core.ranges import check_ranges

Precision = Literal["auto", "fp32", "bf16"]
Schedule = Literal["cosine", "constant"]


@dataclass(frozen=True, kw_only=True, slots=True)
class AugmentConfig:
    """Random augmentation of the training images, sampled for every sample.

    Attributes:
        shift_px: Largest shift of the image in x and in y, pixels; the border is repeated (DrQ-v2,
            arXiv:2107.09645, section 3.1). 0 switches it off.
        brightness: Largest relative change of brightness, as ``0.2`` for 80 to 120 %.
        contrast: Largest relative change of contrast about the mean of the image.
        saturation: Largest relative change of saturation about the grey image.
        hue: Largest turn of the hue, as a share of a whole turn.
        convolution: Share of the samples whose images are mixed, in random proportion, with their convolution
            by a random 3x3 filter of the same mean and contrast (arXiv:2007.13003, section 3).
        overlay: Largest opacity of random, smooth colours that are laid over the image.
        tone: Share of the samples whose luma follows a random curve, at the same chroma: a shadow is then as
            often lighter than what it falls on as darker.
        shadow: Share of the samples on whose images random spots are darkened.
        swap: Share of the samples in which ``swap_camera`` shows what it shows in another sample: a policy
            learns to look at it less.
        swap_camera: Name of that camera.
    """

    shift_px: int = 0
    brightness: float = 0.0
    contrast: float = 0.0
    saturation: float = 0.0
    hue: float = 0.0
    convolution: float = 0.0
    overlay: float = 0.0
    tone: float = 0.0
    shadow: float = 0.0
    swap: float = 0.0
    swap_camera: str = "front"

    def __post_init__(self) -> None:
        if self.shift_px < 0:
            raise ConfigError(f"augment.shift_px must be 0 (off) or more pixels, given {self.shift_px}.")
        for name in ("brightness", "contrast", "saturation"):
            value = getattr(self, name)
            if not 0.0 <= value < 1.0:
                raise ConfigError(f"augment.{name} must be from 0 (off) to below 1, given {value}.")
        shares = ("convolution", "overlay", "tone", "shadow", "swap")
        for name, most in (("hue", 0.5), *((share, 1.0) for share in shares)):
            if not 0.0 <= getattr(self, name) <= most:
                raise ConfigError(
                    f"augment.{name} must be from 0 (off) to {most:g}, given {getattr(self, name)}."
                )

    @property
    def recolours(self) -> bool:
        """Whether colours are changed."""
        mixed = self.convolution, self.overlay, self.tone, self.shadow
        return any((self.brightness, self.contrast, self.saturation, self.hue, *mixed))

    @property
    def enabled(self) -> bool:
        """Whether anything is changed at all."""
        return self.recolours or any((self.shift_px, self.swap))


_MOST = {"batch_size": 1 << 20, "num_threads": 1024}
"""What no machine trains with: more would fill memory or stand still before a message."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainConfig:
    """Settings of the optimizer.

    Attributes:
        steps: Gradient steps; of a policy that learns from an env, environment steps, over all its
            environments together, and so are ``save_every`` and ``log_every``.
        batch_size: Samples per gradient step, over all processes together.
        mixing: Of several tasks that are learned together: each has a share of every batch in proportion to
            its frames to this power. 0 samples tasks equally often, 1 frames.
        lr: Peak learning rate of AdamW.
        lr_backbone: Peak learning rate of the image backbone; None takes ``lr``, which ``lerobot``,
            ``openvla`` and ``octo`` take for all their parts.
        lr_muon: Peak learning rate of Muon for the matrices of linear layers; None trains them by AdamW too.
        weight_decay: Decoupled weight decay of AdamW.
        betas: Moment decays of AdamW.
        warmup_steps: Steps over which the learning rate rises linearly from 0.
        schedule: ``cosine`` falls to 0 at the end of training, ``constant`` stays.
        grad_clip: Largest L2 norm of the gradient; 0 does not clip.
        ema: Keep an exponential moving average of the weights, and save that as the policy; None leaves
            the choice to the policy (on for diffusion, off for ACT).
        ema_power: Exponent of the average's warm-up, see :mod:`roboverse_learn.training.imitation.ema`.
        ema_max_decay: Largest decay of the average.
        precision: ``bf16`` computes under autocast; ``auto`` takes it where the processor has
            instructions for it. Weights, optimizer and evaluation stay float32.
        compile: Compile the network with ``torch.compile``; None compiles our own policies
            on a GPU, and those of other packages nowhere. It is used if the
            gradients of the first batches are those of eager code, and left out with a warning otherwise.
        cuda_graphs: Record the kernels of the loss, forward and backward, and play them back, on a GPU:
            for a network so small that the GPU waits for Python to launch its kernels. It is used under the
            same condition as what is compiled.
        num_threads: Threads of the CPU; 0 takes OMP_NUM_THREADS or one per core, and one beside a GPU.
        save_every: Steps between checkpoints; the last step is always saved.
        log_every: Steps between logged metrics.
        time_limit_s: Stop after so many seconds of training, if not done before, and let the schedule
            end there; None trains all steps. A run that hits its limit is not bit-identical when repeated.
        wandb: Log to Weights & Biases too.
        resume_from: Checkpoint of the same policy, or its run, whose weights and normalization training
            begins with, as to go on with corrections; empty begins anew. The optimizer begins anew in both
            cases.
        augment: Random changes of the training images.
    """

    steps: int = 100_000
    batch_size: int = 32
    mixing: float = 0.0
    lr: float = 1e-4
    lr_backbone: float | None = None
    lr_muon: float | None = None
    weight_decay: float = 1e-4
    betas: tuple[float, float] = (0.9, 0.999)
    warmup_steps: int = 500
    schedule: Schedule = "cosine"
    grad_clip: float = 10.0
    ema: bool | None = None
    ema_power: float = 0.75
    ema_max_decay: float = 0.9999
    precision: Precision = "auto"
    compile: bool | None = None
    cuda_graphs: bool = False
    num_threads: int = 0
    save_every: int = 5_000
    log_every: int = 50
    time_limit_s: float | None = None
    wandb: bool = False
    resume_from: str = ""
    augment: AugmentConfig = AugmentConfig()

    def __post_init__(self) -> None:
        self._check_numbers()
        for name, valid in (("precision", ("auto", "fp32", "bf16")), ("schedule", ("cosine", "constant"))):
            if getattr(self, name) not in valid:
                raise ConfigError(
                    f"train.{name} must be one of {', '.join(valid)}, given '{getattr(self, name)}'."
                )

    def limited_s(self, seconds: float) -> float:
        """Returns seconds of training, at most the time limit."""
        return seconds if self.time_limit_s is None else min(seconds, self.time_limit_s)

    def _check_numbers(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, float) and not math.isfinite(value):
                raise ConfigError(f"train.{item.name} must be a finite number, given {value}.")
        check_ranges(
            self,
            "train.",
            above_0=("steps", "batch_size", "lr", "save_every", "log_every", "ema_power"),
            from_0=("weight_decay", "warmup_steps", "grad_clip", "num_threads", "lr_backbone", "lr_muon"),
        )
        for key, most in _MOST.items():
            if (given := getattr(self, key)) > most:
                raise ConfigError(f"train.{key} must be at most {most:,}, given {given:,}.")
        if self.time_limit_s is not None and self.time_limit_s <= 0:
            raise ConfigError(f"train.time_limit_s must be above 0 seconds, or null for no limit, "
                              f"given {self.time_limit_s}.")  # fmt: skip
        if not 0.0 <= self.mixing <= 1.0:
            raise ConfigError(f"train.mixing must be from 0 to 1, given {self.mixing}.")
        if len(self.betas) != 2 or not all(0.0 <= beta < 1.0 for beta in self.betas):
            raise ConfigError(f"train.betas must be two numbers from 0 to below 1, given {self.betas}.")
        if not 0.0 <= self.ema_max_decay < 1.0:
            raise ConfigError(f"train.ema_max_decay must be from 0 to below 1, given {self.ema_max_decay}.")

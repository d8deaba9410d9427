"""A gradient step on frames that stay on the device, against LeRobot's: ``roboverse speed training``.

Both train the same network, in the paper's size, from the same weights, on the same frames, in bf16, with
AdamW. LeRobot's side is what ``lerobot-train`` does once it has a batch: its processors, its policy's
forward and backward pass, clipping, optimizer, and the loss as a number. Its batch is on the device
already, so the cost of its loader is left out, in its favor.
"""

import itertools
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch

from envs.core.errors import SimulatorError
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

POLICIES = ("act", "diffusion")
CAMERA = "observation.images.front"
GOAL = 2.0
SAME_LOSS = 0.02
"""Largest relative difference of the losses: bf16 has 8 bits, and compiled kernels round differently."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Scale:
    """Sizes and repetitions of a measurement."""

    batch_size: int  # samples of a step
    image_size: int  # pixels a side
    num_frames: int  # frames that batches are gathered from
    steps: int  # timed steps of one turn
    turns: int  # how often each side is timed
    compared: int  # steps whose losses are compared


GPU = Scale(batch_size=256, image_size=256, num_frames=4000, steps=10, turns=5, compared=20)
CPU = Scale(batch_size=2, image_size=64, num_frames=16, steps=1, turns=2, compared=3)


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainingSettings(Settings):
    """Compares a gradient step to LeRobot's, and the losses of the first steps.

    Attributes:
        parts: act, diffusion.
        device: ``auto``, ``cpu``, ``cuda``.
        cuda_graphs: Whether our side replays CUDA graphs on a GPU, as with ``preset=gpu``.
        out: JSON file for the measurements.
    """

    device: str = "auto"
    cuda_graphs: bool = True


@dataclass(frozen=True, kw_only=True, slots=True)
class Compilation:
    """Whether our side is compiled, and whether it replays CUDA graphs."""

    enabled: bool
    cuda_graphs: bool = False


def parts(settings: TrainingSettings) -> Mapping[str, Callable[[], Measurement]]:
    """Returns what is measured."""
    from roboverse_learn.training.device import resolve_device

    device = resolve_device(settings.device)
    on_gpu = device == "cuda"
    compilation = Compilation(enabled=on_gpu, cuda_graphs=on_gpu and settings.cuda_graphs)
    scale = GPU if on_gpu else CPU
    return {name: partial(measure, name, scale, device, compilation) for name in POLICIES}


class Frames:
    """Random frames on a device, and batches of them, as a resident dataset returns them.

    Args:
        scale: How many, and how large.
        windows: Frames relative to a sample's own, by key, as a policy reads them.
        device: Torch device.
    """

    def __init__(self, scale: Scale, windows: Mapping[str, list[int]], device: str) -> None:
        generator = torch.Generator().manual_seed(0)
        size = scale.image_size
        coarse = torch.rand(scale.num_frames, 3, 8, 8, generator=generator)
        images = torch.nn.functional.interpolate(coarse, (size, size), mode="bilinear")
        self._frames = {
            CAMERA: (255 * images).to(torch.uint8).to(device),
            "observation.state": torch.rand(scale.num_frames, 9, generator=generator).to(device),
            "action": torch.rand(scale.num_frames, 9, generator=generator).to(device),
        }
        self._windows, self._scale, self._device = windows, scale, device

    def batch(self, step: int) -> dict[str, Any]:
        """Returns the batch of a step; the same step has the same batch."""
        generator = torch.Generator().manual_seed(step)
        rows = torch.randint(self._scale.num_frames, (self._scale.batch_size,), generator=generator)
        batch = {}
        for key, frames in self._frames.items():
            index = rows
            if key in self._windows:
                window = torch.tensor(self._windows[key])
                index = (rows[:, None] + window).clamp(0, self._scale.num_frames - 1)
                batch[f"{key}_is_pad"] = torch.zeros(index.shape, dtype=torch.bool, device=self._device)
            batch[key] = frames[index.to(self._device)]
        return batch


type Side = Callable[[int], Any]
"""Makes the step of a number; returns its loss."""


def measure(name: str, scale: Scale, device: str, compilation: Compilation) -> Measurement:
    """Compares the steps of one policy, each side training a network of its own.

    Args:
        name: Policy.
        scale: How much.
        device: Torch device.
        compilation: Of our side.

    Raises:
        SimulatorError: if the losses of the first steps differ by more than :data:`SAME_LOSS`.
    """
    apart = _losses_apart(name, scale, device, compilation)
    if not apart <= SAME_LOSS:
        raise SimulatorError(f"The losses differ by {apart:.1%}: the two do not train the same network.")
    sides = _sides(name, scale, device, compilation, {})
    ours, theirs = (repeat(partial(_next, side, itertools.count()), scale.steps) for side in sides)
    seconds = in_turns(ours, theirs, scale.turns, wait=cuda_wait(device))
    title = (
        f"training step of {name}, batch {scale.batch_size}, {scale.image_size}×{scale.image_size}, bf16 on "
        f"{device}, LeRobot / ours (losses differ by {apart:.2%})"
    )
    return measurement(title, seconds, Goal(GOAL, applies=device == "cuda"), units=scale.steps)


def _next(side: Side, steps: itertools.count) -> None:
    side(next(steps))


def _losses_apart(name: str, scale: Scale, device: str, compilation: Compilation) -> float:
    """Returns the largest relative difference of the losses of the first steps.

    Without dropout: compiled code samples it in another order than the noise of ACT's style variable, and
    the losses of the first step would differ by 4 %.
    """
    sides = _sides(name, scale, device, compilation, {"dropout": 0.0} if name == "act" else {})
    losses = [[float(take(step)) for take in sides] for step in range(scale.compared)]
    return max(abs(ours - theirs) / abs(theirs) for ours, theirs in losses)


def _sides(
    name: str, scale: Scale, device: str, compilation: Compilation, changes: Mapping[str, Any]
) -> tuple[Side, Side]:
    """Returns our step and LeRobot's, each with a network and frames of its own, from the same weights."""
    import policies
    from roboverse_learn.training.imitation.estimate import plain_stats

    norms = {"backbone_norm": "frozen"} if name == "act" else {}  # as LeRobot trains
    config = policies.config_class(name)(**norms, **changes)
    size = (scale.image_size, scale.image_size, 3)
    vector = {"dtype": "float32", "shape": (9,), "names": None}
    image = {"dtype": "video", "shape": size, "names": ["height", "width", "channels"]}
    features = {CAMERA: image, "observation.state": vector, "action": vector}

    def side(make: Callable[[Any, Frames, Compilation], Side]) -> Side:
        policy = policies.create(name, features, plain_stats(features), config, device)
        return make(policy, Frames(scale, policy.delta_indices, device), compilation)

    return side(_our_step), side(_lerobot_step)


def _our_step(policy: Any, frames: Frames, compilation: Compilation) -> Side:
    """Returns a step of :mod:`roboverse_learn.training.imitation.train`."""
    from policies.compilation import compile_objective
    from policies.cuda_graphs import RecordedObjective
    from roboverse_learn.training.config import TrainConfig
    from roboverse_learn.training.imitation.train import make_optimizer

    policy.begin_training()
    objective = policy.objective()
    if compilation.enabled:
        compile_objective(objective)
    if compilation.cuda_graphs:
        objective = RecordedObjective(objective, frames.batch(0), "bf16")
    optimizer = make_optimizer(policy, TrainConfig())

    def take(step: int) -> Any:
        torch.manual_seed(step)
        with torch.autocast(policy.device.type, torch.bfloat16):
            loss, _terms = objective(frames.batch(step))
        _update(loss, policy, optimizer)
        return loss.detach().clone()

    return take


def _lerobot_step(policy: Any, frames: Frames, _compilation: Compilation) -> Side:
    """Returns the step of ``lerobot.scripts.lerobot_train.update_policy``, in bf16."""
    policy.model.train()
    optimizer = torch.optim.AdamW(policy.model.parameters(), lr=1e-4, weight_decay=1e-4)

    def take(step: int) -> Any:
        torch.manual_seed(step)
        batch = frames.batch(step)
        batch[CAMERA] = batch[CAMERA].float() / 255.0  # as its dataset returns images
        batch = policy.preprocessor(batch)
        with torch.autocast(policy.device.type, torch.bfloat16):
            loss, _terms = policy.model.forward(batch)
        _update(loss, policy, optimizer)
        loss.item()
        return loss.detach()

    return take


def _update(loss: Any, policy: Any, optimizer: Any) -> None:
    loss.backward()
    torch.nn.utils.clip_grad_norm_(policy.model.parameters(), 10.0)
    optimizer.step()
    optimizer.zero_grad()


if __name__ == "__main__":
    sys.exit(program("training", TrainingSettings, parts))

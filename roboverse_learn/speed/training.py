"""A gradient step on frames that stay on the device, against LeRobot's: ``roboverse speed training``.

Both train the same network, in the paper's size, from the same weights, on the same frames, in bf16, with
AdamW. LeRobot's side is what ``lerobot-train`` does once it has a batch: its processors, its policy's
forward and backward pass, clipping, optimizer, and the loss as a number. Its batch is on the device
already, so the cost of its loader is left out, in its favor.
"""

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

import torch

from envs.core.errors import SimulatorError
from envs.core.observation_keys import IMAGE_PREFIX
from roboverse_learn.data.dataset.schema import make_features
from roboverse_learn.speed.harness import DeviceProgram, Goal, Measurement, part_each, scaled

CAMERA = f"{IMAGE_PREFIX}front"

type Side = Callable[[], Any]
"""Makes the next gradient step; returns its loss."""


@dataclass(frozen=True, kw_only=True, slots=True)
class GradientSteps(DeviceProgram):
    """Keys of a speed program that compares gradient steps.

    Attributes:
        batch_size: Samples of a step.
        image_size: Pixels a side.
        num_frames: Frames that batches are gathered from.
        steps: Timed steps of one turn.
        turns: How often each side is timed.
        compared: Steps whose losses are compared.
    """

    instruction: ClassVar[str] = ""
    """Of every frame, where the policy reads one."""
    same_loss: ClassVar[float]
    """Largest relative difference of the losses."""

    batch_size: int = scaled(gpu=256, cpu=2)
    image_size: int = scaled(gpu=256, cpu=64)
    num_frames: int = scaled(gpu=4000, cpu=16)
    steps: int = scaled(gpu=10, cpu=1)
    turns: int = scaled(gpu=5, cpu=2)
    compared: int = scaled(gpu=20, cpu=3)

    def our_step(self, policy: Any, *, compile: bool, cuda_graphs: bool = False) -> Side:
        """Returns a step of :mod:`roboverse_learn.training.imitation.train`."""
        from policies.compilation import compile_objective
        from policies.cuda_graphs import RecordedObjective
        from roboverse_learn.training.config import TrainConfig
        from roboverse_learn.training.imitation.optimizer import make_optimizer
        from roboverse_learn.training.imitation.update import Update

        batch = self.batches(policy)
        policy.begin_training()
        objective = policy.objective()
        if compile:
            compile_objective(objective)
        if cuda_graphs:
            objective = RecordedObjective(objective, batch(0), "bf16")
        config = policy.training_config(TrainConfig())

        def loss_of(given: dict[str, Any]) -> Any:
            with torch.autocast(policy.device.type, torch.bfloat16):
                return objective(given)[0]

        optimizer = make_optimizer(policy, config)
        update = Update(policy, optimizer, grad_clip=config.grad_clip, record=cuda_graphs)
        return _steps(batch, loss_of, lambda: update(1.0))

    def lerobot_step(self, policy: Any, optimizer: Any, grad_clip: float, *, bf16: bool = True) -> Side:
        """Returns the step of ``lerobot.scripts.lerobot_train.update_policy``, in bf16 or in fp32."""
        policy.model.train()

        def loss_of(given: dict[str, Any]) -> Any:
            given[CAMERA] = given[CAMERA].float() / 255.0  # as its dataset returns images
            given = policy.preprocessor(given)
            with torch.autocast(policy.device.type, torch.bfloat16, enabled=bf16):
                return policy.model.forward(given)[0]

        def update() -> None:
            torch.nn.utils.clip_grad_norm_(policy.model.parameters(), grad_clip)
            optimizer.step()
            optimizer.zero_grad()

        step = _steps(self.batches(policy), loss_of, update)

        def take() -> Any:
            with _tf32():
                loss = step()
            loss.item()
            return loss

        return take

    def batches(self, policy: Any) -> Callable[[int], dict[str, Any]]:
        """Returns what gathers the batch of a step from random frames, as a resident dataset does.

        The frames are on the policy's device; the same step has the same batch.
        """
        generator = torch.Generator().manual_seed(0)
        count, size, device = self.num_frames, self.image_size, policy.device
        coarse = torch.rand(count, 3, 8, 8, generator=generator)
        images = torch.nn.functional.interpolate(coarse, (size, size), mode="bilinear")
        frames = {
            CAMERA: (255 * images).to(torch.uint8).to(device),
            "observation.state": torch.rand(count, 9, generator=generator).to(device),
            "action": torch.rand(count, 9, generator=generator).to(device),
        }
        words = {"task": [self.instruction] * self.batch_size} if self.instruction else {}

        def batch(step: int) -> dict[str, Any]:
            draws = torch.Generator().manual_seed(step)
            rows = torch.randint(count, (self.batch_size,), generator=draws)
            found: dict[str, Any] = dict(words)
            for key, values in frames.items():
                index = rows
                if key in policy.delta_indices:
                    window = torch.tensor(policy.delta_indices[key])
                    index = (rows[:, None] + window).clamp(0, count - 1)
                    found[f"{key}_is_pad"] = torch.zeros(index.shape, dtype=torch.bool, device=device)
                found[key] = values[index.to(device)]
            return found

        return batch

    def losses_apart(self, sides: tuple[Side, Side]) -> float:
        """Returns the largest relative difference of the first losses, which :attr:`same_loss` bounds."""
        losses = [[float(take()) for take in sides] for _ in range(self.compared)]
        apart = max(abs(ours - theirs) / abs(theirs) for ours, theirs in losses)
        if not apart <= self.same_loss:  # NaN is not <=
            raise SimulatorError(f"The losses differ by {apart:.1%}: the two do not train the same network.")
        return apart


@dataclass(frozen=True, kw_only=True, slots=True)
class Training(GradientSteps):
    """Compares a gradient step to LeRobot's, and the losses of the first steps.

    Attributes:
        parts: act, diffusion.
        cuda_graphs: Whether our side replays CUDA graphs on a GPU, as with ``preset=gpu``.
    """

    same_loss: ClassVar = 0.02  # bf16 has 8 bits, and compiled kernels round differently

    cuda_graphs: bool = True

    @part_each("act", "diffusion")
    def step(self, name: str) -> Measurement:
        """Compares the steps of one policy, each side training a network of its own."""
        import policies
        from roboverse_learn.training.imitation.estimate import plain_stats

        size, on_gpu, is_act = self.image_size, self.on_gpu, name == "act"
        features = plain_features(size)
        norm = {"backbone_norm": "frozen"} if is_act else {}  # as LeRobot trains

        def sides(**changes: Any) -> tuple[Side, Side]:
            config = policies.config_class(name)(**norm, **changes)
            stats = plain_stats(features)
            first, second = (policies.create(name, features, stats, config, self.device) for _ in range(2))
            optimizer = torch.optim.AdamW(second.model.parameters(), lr=1e-4, weight_decay=1e-4)
            ours = self.our_step(first, compile=on_gpu, cuda_graphs=on_gpu and self.cuda_graphs)
            return ours, self.lerobot_step(second, optimizer, 10.0)

        # Without dropout: compiled code samples it in another order than the noise of ACT's style variable,
        # and the losses of the first step would differ by 4 %.
        apart = self.losses_apart(sides(dropout=0.0) if is_act else sides())
        title = (
            f"training step of {name}, batch {self.batch_size}, {size}×{size}, bf16 on {self.device}, "
            f"LeRobot / ours (losses differ by {apart:.2%})"
        )
        return self.compare(title, *sides(), Goal(2.0, applies=on_gpu), calls=self.steps)


def plain_features(image_size: int) -> Any:
    """Returns the features of a dataset with one camera, nine joints and nine targets."""
    joints = [str(number) for number in range(9)]
    return make_features(joints, joints, {"front": (image_size, image_size)})


def _steps(batch: Callable[[int], Any], loss_of: Callable[[Any], Any], update: Callable[[], object]) -> Side:
    """Returns what takes a step by the loss of the next batch."""
    numbers = itertools.count()

    def take() -> Any:
        number = next(numbers)
        torch.manual_seed(number)
        loss = loss_of(batch(number))
        loss.backward()
        update()
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

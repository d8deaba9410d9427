"""Imitation: a policy learns the actions of a dataset.

The loop is independent of losses and networks: a policy normalizes its batch and computes its loss.
"""

import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from policies.checkpoint import read_weights, weights_path
from policies.cuda_graphs import Recorded, RecordedObjective
from policies.imitation import ImitationPolicy
from policies.objective import Loss
from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.data.dataset.sampler import make_sampler
from roboverse_learn.training import checkpoint
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.device import cpu_threads, resolve_precision
from roboverse_learn.training.divergence import TrainingDivergedError
from roboverse_learn.training.imitation.ema import Ema
from roboverse_learn.training.imitation.fast_objective import NUM_BATCHES, fast_objective
from roboverse_learn.training.imitation.gradient_mean import average_gradients, share_weights
from roboverse_learn.training.imitation.image_augmentation import augment_cameras
from roboverse_learn.training.imitation.optimizer import make_optimizer
from roboverse_learn.training.imitation.schedule import learning_rate_factor, progress
from roboverse_learn.training.imitation.update import Update
from roboverse_learn.training.interruption import Interruption, signals_noted
from roboverse_learn.training.metrics import MetricsWriter, open_writers, plot_training
from roboverse_learn.training.randomness import step_seed
from roboverse_learn.training.reporter import Progress, Reporter, TrainResult, seconds_left

logger = logging.getLogger(__name__)

_FEW_FRAMES = 0.1
"""Share of the frames below which those that begin no sample are not mentioned."""


class FrameDataset(Protocol):
    """What training needs of a dataset; see :class:`roboverse_learn.data.dataset.reader.ResidentDataset`."""

    info: DatasetInfo

    def sample(
        self, indices: np.ndarray, delta_indices: Mapping[str, Sequence[int]], *, keys: Sequence[str]
    ) -> dict[str, Tensor]:
        """Returns frames: images uint8 (B, [T,] C, H, W), vectors float32 (B, [T,] D), ``<key>_is_pad``."""
        ...


def train(
    policy: ImitationPolicy,
    dataset: FrameDataset,
    config: TrainConfig,
    run_dir: str | Path,
    *,
    seed: int = 0,
    reporter: Reporter | None = None,
    resume: bool = True,
) -> TrainResult:
    """Trains a policy, in one process or in each of those of ``accelerate launch``.

    A run that is killed resumes from its last checkpoint, to the same losses on a CPU (unless a time
    limit ends its schedule). SIGINT and SIGTERM end it with a checkpoint.

    Args:
        policy: An untrained policy, on the device to train on; trained in place.
        dataset: The demonstrations.
        config: How to train.
        run_dir: Where checkpoints, metrics and plots go.
        seed: Root of all randomness.
        reporter: Hears of the progress.
        resume: Go on from the last checkpoint of ``run_dir``, if there is one.

    Raises:
        CheckpointError: if the checkpoint to go on from is damaged or of another configuration, or if a
            new one cannot be written.
        ConfigError: if the batch cannot be divided among the processes.
        Interrupted: after a checkpoint, if SIGINT or SIGTERM came.
        TrainingDivergedError: if the loss becomes infinite or NaN.
    """
    devices = [torch.cuda.current_device()] if policy.device.type == "cuda" else []
    with cpu_threads(config.num_threads, policy.device.type), torch.random.fork_rng(devices=devices):
        trainer = _Trainer(policy, dataset, config, Path(run_dir), seed, reporter or Reporter())
        return trainer.run(resume)


class _Trainer:
    """One run of :func:`train`."""

    def __init__(
        self,
        policy: ImitationPolicy,
        dataset: FrameDataset,
        config: TrainConfig,
        run_dir: Path,
        seed: int,
        reporter: Reporter,
    ) -> None:
        from accelerate import Accelerator

        self.policy, self.dataset, self.config = policy, dataset, config
        self.run_dir, self.seed, self.reporter = run_dir, seed, reporter
        self.accelerator: Any = Accelerator(cpu=policy.device.type == "cpu")
        self.rank, self.world = self.accelerator.process_index, self.accelerator.num_processes
        self.is_main = self.accelerator.is_main_process
        self.precision = resolve_precision(config.precision, policy.device)
        self.sampler = make_sampler(
            dataset,
            batch_size=config.batch_size,
            seed=seed,
            mixing=config.mixing,
            drop_last_frames=policy.drop_last_frames,
            rank=self.rank,
            world_size=self.world,
        )
        if self.is_main:
            _warn_of_frames_left_out(
                policy.drop_last_frames, self.sampler.num_frames, dataset.info.num_frames
            )
        self.keys = [*policy.shapes, *policy.columns]
        policy.begin_training()
        if self.world > 1:
            share_weights(policy.model)
        self.augmented: Callable[..., dict[str, Tensor]] = self._augmented
        self.objective, self.optimizer = self._make_objective(), make_optimizer(policy, config)
        self.ema = self._make_ema()
        # Of several processes the gradients alone: a recording beside their messages is not tried.
        recorded = isinstance(self.objective, RecordedObjective) and self.world == 1
        if recorded:
            self.augmented = Recorded(self._augmented)
        self.update = Update(policy, self.optimizer, self.ema, grad_clip=config.grad_clip, record=recorded)
        self.parameters = list(policy.model.parameters())
        self.step, self.first_step, self.elapsed_before = 0, 0, 0.0
        self.shared_elapsed = 0.0  # of the first process, which the learning rate of all follows
        self.losses: list[dict[str, Tensor]] = []
        self.loss: float | None = None
        self.grad_norm: Tensor | float = 0.0
        self.lr = 0.0
        self.start = time.perf_counter()

    def _make_objective(self) -> nn.Module:
        on_gpu = self.policy.device.type == "cuda"
        default = on_gpu and self.policy.default_compile
        compile = default if self.config.compile is None else self.config.compile
        cuda_graphs = on_gpu and self.config.cuda_graphs
        if not (compile or cuda_graphs):
            return self.policy.objective()
        start = self.sampler.state_dict()
        batches = [self._batch() for _ in range(NUM_BATCHES)]
        self.sampler.load_state_dict(start)
        return fast_objective(self.policy, batches, self.precision, compile=compile, cuda_graphs=cuda_graphs)

    def run(self, resume: bool) -> TrainResult:
        """Trains to the end."""
        if self.is_main:
            checkpoint.remove_leftovers(self.run_dir)
        self.accelerator.wait_for_everyone()  # the others look for what the first has put right
        directory = checkpoint.last_checkpoint(self.run_dir) if resume else None
        if directory is not None:
            self._load(directory)
        self.run_dir.mkdir(parents=True, exist_ok=True)
        writers = open_writers(self.run_dir, self.step, self.config, self.policy.name) if self.is_main else []
        self.start = time.perf_counter()
        self.shared_elapsed = self.elapsed_before
        saved_at = self.step if directory is not None else None
        with signals_noted() as interruption:
            try:
                self._report("on_start", self._progress(), self.policy)
                while self.step < self.config.steps and not self._is_to_stop(interruption):
                    self._gradient_step()
                    if self.step % self.config.log_every == 0 or self.step == self.config.steps:
                        self._log(writers)
                    self._report("on_step", self._progress())
                    if self.step % self.config.save_every == 0:
                        self._log(writers)  # a loss that is not finite stops the run before it is saved
                        self._save()
                        saved_at = self.step
                if saved_at != self.step:
                    self._log(writers)
                    self._save()
            finally:
                for writer in writers:
                    writer.close()
            self.accelerator.wait_for_everyone()
            if self.world > 1:
                self.accelerator.end_training()  # leaves the process group, which NCCL asks for
        return self._finish()

    def _gradient_step(self) -> None:
        torch.manual_seed(step_seed(self.seed, self.step, self.rank))
        factor = learning_rate_factor(self.config, self.step, self.shared_elapsed)
        self.lr = self.optimizer.param_groups[0]["peak_lr"] * factor
        loss, terms = self.forward(self._batch())
        loss.backward()
        if self.world > 1:
            average_gradients(self.parameters, self.world)
        self.grad_norm = self.update(factor)
        # Copies, for a CUDA graph writes the next step's to the same memory.
        self.losses.append({name: value.detach().clone() for name, value in {"loss": loss, **terms}.items()})
        self.step += 1

    def forward(self, batch: dict[str, Tensor]) -> Loss:
        """Returns the loss of a batch, and its terms."""
        enabled = self.precision == "bf16"
        with torch.autocast(self.policy.device.type, torch.bfloat16, enabled=enabled):
            return self.objective(batch)

    def _batch(self) -> dict[str, Tensor]:
        """Returns this process's share of the step's batch, augmented, on the device."""
        batch = self.dataset.sample(self.sampler.next_batch(), self.policy.delta_indices, keys=self.keys)
        if self.config.augment.enabled:
            batch |= self.augmented(*(batch[key].to(self.policy.device) for key in self.policy.image_keys))
        device = self.policy.device
        return {key: value.to(device, non_blocking=True) for key, value in batch.items()}

    def _augmented(self, *images: Tensor) -> dict[str, Tensor]:
        """Returns the augmented images of the cameras, which are given in the order of the policy's."""
        return augment_cameras(dict(zip(self.policy.image_keys, images, strict=True)), self.config.augment)

    def _make_ema(self) -> Ema | None:
        wanted = self.policy.default_ema if self.config.ema is None else self.config.ema
        if not wanted:
            return None
        return Ema(self.policy.state_dict(), self.config.ema_power, self.config.ema_max_decay)

    def _log(self, writers: list[MetricsWriter]) -> None:
        """Logs the means since the last logged step."""
        if not self.losses:
            return
        names = self.losses[0].keys()
        means = torch.stack([torch.stack([row[name] for row in self.losses]).mean() for name in names])
        means = self.accelerator.reduce(means, "mean").tolist()
        row = dict(zip(names, means, strict=True))
        self.losses.clear()
        self.loss = row["loss"]
        if not math.isfinite(row["loss"]):
            raise self._diverged(f"The loss is {self.loss}")
        row |= {
            "lr": self.lr,
            "grad_norm": float(self.grad_norm),
            "samples_per_s": self._samples_per_s() or 0.0,
            "elapsed_s": self._elapsed(),
        }
        for writer in writers:
            writer.write(self.step, row)

    def _diverged(self, what: str) -> TrainingDivergedError:
        return TrainingDivergedError(
            f"{what} at step {self.step}. {checkpoint.what_is_kept(self.run_dir)} "
            "Take a smaller train.lr or train.precision=fp32."
        )

    def _settings(self) -> dict[str, Any]:
        """What a resumed run must share with the one before."""
        return {
            "policy": self.policy.name,
            "batch_size": self.config.batch_size,
            "seed": self.seed,
            "num_frames": self.sampler.num_frames,
            "ema": self.ema is not None,
        }

    def _load(self, directory: Path) -> None:
        ema = self.ema
        state = checkpoint.load_checkpoint(directory, self._settings())
        saved = weights_path(directory / checkpoint.PRETRAINED)
        average = read_weights(saved)
        weights = average if ema is None else checkpoint.part(state.tensors, "weights")
        self.policy.load_state_dict(weights, saved)
        checkpoint.load_moments(self.optimizer, state.tensors, "optimizer")
        if ema is not None:
            for key, value in ema.average.items():
                value.copy_(average[key])
            ema.num_updates = state.numbers["ema_updates"]
        self.step = self.first_step = state.step
        self.elapsed_before = state.elapsed_s
        self.sampler.load_state_dict(dict(state.numbers["sampler"]))
        logger.info("Going on from step %d of '%s'.", self.step, directory)

    def _save(self) -> None:
        if key := checkpoint.not_finite(self.policy.state_dict()):  # of a gradient that overflowed
            raise self._diverged(f"The weight '{key}' is not finite")
        self.accelerator.wait_for_everyone()
        if not self.is_main:
            return
        ema, tensors = self.ema, checkpoint.moments(self.optimizer, "optimizer")
        if ema is not None:
            tensors |= checkpoint.named(self.policy.state_dict(), "weights")
        updates = None if ema is None else ema.num_updates
        state = checkpoint.TrainState(
            step=self.step,
            elapsed_s=self._elapsed(),
            settings=self._settings(),
            numbers={"sampler": self.sampler.state_dict(), "ema_updates": updates},
            tensors=tensors,
        )
        average = None if ema is None else ema.average
        directory = checkpoint.save_checkpoint(self.run_dir, self.policy, state, weights=average)
        self._report("on_checkpoint", self.step, directory)

    def _finish(self) -> TrainResult:
        """Leaves the policy as it was saved, and draws the losses."""
        if self.ema is not None:
            self.policy.load_state_dict(self.ema.average, self.run_dir)
        self.policy.end_training()
        done = self.step >= self.config.steps
        result = TrainResult(
            checkpoint=self.run_dir / "checkpoints" / "last" / checkpoint.PRETRAINED,
            steps=self.step,
            loss=self.loss,
            elapsed_s=self._elapsed(),
            samples_per_s=self._samples_per_s(),
            stopped_by="steps" if done else "time_limit",
            precision=self.precision,
            plot=plot_training(self.run_dir, self.policy.name) if self.is_main else None,
        )
        self._report("on_end", result)
        return result

    def _elapsed(self) -> float:
        return self.elapsed_before + time.perf_counter() - self.start

    def _is_to_stop(self, interruption: Interruption) -> bool:
        """Whether time is over or a signal came, to any of the processes."""
        limit = self.config.time_limit_s
        self.shared_elapsed = self._elapsed()
        over = limit is not None and self.shared_elapsed >= limit
        if self.world == 1:
            return over or bool(interruption)
        if limit is None and self.step % self.config.log_every:
            return False  # asking all waits for the devices, as logging does
        # Clocks differ, and a signal reaches one process before another; processes that stop at different
        # steps would wait for each other forever, and a learning rate that follows the time is to be one.
        own = self.shared_elapsed if self.is_main else 0.0
        asked = torch.tensor([float(over), float(bool(interruption)), own], device=self.policy.device)
        over, interrupted, self.shared_elapsed = self.accelerator.reduce(asked, "sum").tolist()
        if interrupted:
            interruption.hear_of_others()
        return bool(over or interrupted)

    def _samples_per_s(self) -> float | None:
        taken = self.step - self.first_step
        seconds = time.perf_counter() - self.start
        return taken * self.config.batch_size / seconds if taken else None

    def _progress(self) -> Progress:
        seconds = time.perf_counter() - self.start
        return Progress(
            step=self.step,
            steps=self.config.steps,
            fraction=progress(self.config, self.step, self._elapsed()),
            loss=self.loss,
            samples_per_s=self._samples_per_s(),
            elapsed_s=self._elapsed(),
            eta_s=seconds_left(self.config, self.step, self.first_step, seconds, self._elapsed()),
        )

    def _report(self, event: str, *arguments: Any) -> None:
        if self.is_main:
            getattr(self.reporter, event)(*arguments)


def _warn_of_frames_left_out(frames: int, num_sampled: int, num_frames: int) -> None:
    """Warns where many frames begin no sample, since a policy that never acts there cannot end its task."""
    share = 1.0 - num_sampled / num_frames
    if share >= _FEW_FRAMES:
        logger.warning(
            "The last %d frames of every episode begin no training sample, %.0f %% of all: the policy does "
            "not learn to act there. With policy.drop_n_last_frames=0 it does.",
            frames,
            100.0 * share,
        )

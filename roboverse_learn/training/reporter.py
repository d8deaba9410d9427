"""Reporters of a training run's progress."""

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from roboverse_learn.progress import StageProgress

if TYPE_CHECKING:
    from rich.console import Console

    from roboverse_learn.training.config import TrainConfig


@dataclass(frozen=True, kw_only=True, slots=True)
class Progress:
    """Progress of a run.

    Attributes:
        step: Gradient steps taken; environment steps of a policy that learns from an env.
        steps: Such steps in all; a time limit may end the run before.
        fraction: Share of the run that is done, by steps or by time, from 0 to 1.
        loss: Mean loss since the last logged step; None before the first.
        samples_per_s: Samples per second, since this process began; None before the first step.
        elapsed_s: Seconds of training, over all resumptions.
        eta_s: Seconds that are left; None before the first step.
        success_rate: Share of the last episodes that succeeded, if it learns from an env.
        episode_return: Mean return of the last episodes, likewise.
    """

    step: int
    steps: int
    fraction: float
    loss: float | None
    samples_per_s: float | None
    elapsed_s: float
    eta_s: float | None
    success_rate: float | None = None
    episode_return: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainResult:
    """Result of a run.

    Attributes:
        checkpoint: The LeRobot pretrained folder.
        steps: Gradient steps taken, over all resumptions; environment steps where it learned from an env.
        loss: Last logged loss; None if the run was complete before.
        elapsed_s: Seconds of training, over all resumptions.
        samples_per_s: Samples per second of this process; None if it took no step.
        stopped_by: ``steps`` or ``time_limit``.
        precision: ``fp32`` or ``bf16``.
        plot: The loss curves; None if nothing was logged.
    """

    checkpoint: Path
    steps: int
    loss: float | None
    elapsed_s: float
    samples_per_s: float | None
    stopped_by: str
    precision: str
    plot: Path | None


def seconds_left(
    config: "TrainConfig", step: int, first_step: int, seconds: float, elapsed_s: float
) -> float | None:
    """Estimates how long training still takes; None before the first step.

    Args:
        config: How the run trains.
        step: Steps taken, over all resumptions.
        first_step: Step that this process started at.
        seconds: Seconds of training of this process.
        elapsed_s: Seconds of training, over all resumptions.
    """
    taken = step - first_step
    if not taken:
        return None
    left = seconds / taken * max(0, config.steps - step)
    return left if config.time_limit_s is None else max(0.0, min(left, config.time_limit_s - elapsed_s))


class Reporter:
    """Base of reporters, which does nothing. Called in the main process only."""

    def on_start(self, progress: Progress, policy: Any) -> None:
        """The run begins, or resumes at ``progress.step``."""

    def on_step(self, progress: Progress) -> None:
        """One more gradient step, or environment step of a policy that learns from an env."""

    def on_checkpoint(self, step: int, directory: Path) -> None:
        """A checkpoint is complete."""

    def on_end(self, result: TrainResult) -> None:
        """The run is complete."""


class ProgressReporter(Reporter):
    """Shows the loss, the speed and the time left; see :class:`roboverse_learn.progress.StageProgress`.

    Args:
        console: Console to print to; None takes the standard output.
    """

    def __init__(self, console: "Console | None" = None) -> None:
        self._progress = StageProgress("training", console)
        self._shown = contextlib.ExitStack()

    def on_start(self, progress: Progress, policy: Any) -> None:
        """Shows what is trained, and the bar."""
        again = f", resumed at step {progress.step:,}" if progress.step else ""
        size, device = f"{policy.n_params / 1e6:.1f} M parameters", policy.device.type
        self._progress.print(f"Training {policy.name} with {size} on {device}{again}")
        self._shown.enter_context(self._progress)

    def on_step(self, progress: Progress) -> None:
        """Moves the bar."""
        parts = []
        if progress.success_rate is not None:
            parts.append(f"success {100 * progress.success_rate:.0f} %")
        if progress.episode_return is not None:
            parts.append(f"return {progress.episode_return:.1f}")
        if progress.loss is not None:
            parts.append(f"loss {progress.loss:.4f}")
        if progress.samples_per_s is not None:
            parts.append(f"{progress.samples_per_s:.0f} samples/s")
        text = ", ".join(parts)
        self._progress.update(progress.step, progress.steps, text, progress.eta_s, progress.fraction)

    def on_end(self, result: TrainResult) -> None:
        """Removes the bar."""
        self.close()

    def close(self) -> None:
        """Frees the terminal; also to be called when the run fails."""
        self._shown.close()

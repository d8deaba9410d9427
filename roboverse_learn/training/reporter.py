"""How a training run tells whoever started it how far it is."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from roboverse_learn.training.config import TrainConfig


@dataclass(frozen=True, kw_only=True, slots=True)
class Progress:
    """Where a run is.

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
    """What a run came to.

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
    """Hears of a run; does nothing. Called in the main process only."""

    def on_start(self, progress: Progress, policy: Any) -> None:
        """The run begins, or goes on at ``progress.step``."""

    def on_step(self, progress: Progress) -> None:
        """One more gradient step, or environment step of a policy that learns from an env."""

    def on_checkpoint(self, step: int, directory: Path) -> None:
        """A checkpoint is complete."""

    def on_end(self, result: TrainResult) -> None:
        """The run is complete."""


class RichReporter(Reporter):
    """A progress bar with the loss, the speed and the time left.

    Args:
        console: Where to draw; None takes the standard output.
    """

    def __init__(self, console: "Console | None" = None) -> None:
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bar

        self._bar = Bar(
            TextColumn("training"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f} %  {task.description}"),
            TimeElapsedColumn(),
            console=console,
        )
        self._task = self._bar.add_task("", total=1.0)

    def on_start(self, progress: Progress, policy: Any) -> None:
        """Shows the bar."""
        self._bar.start()
        again = f", going on at step {progress.step:,}" if progress.step else ""
        size, device = f"{policy.n_params / 1e6:.1f} M parameters", policy.device.type
        self._bar.console.print(f"Training {policy.name} with {size} on {device}{again}")

    def on_step(self, progress: Progress) -> None:
        """Moves the bar."""
        parts = [f"step {progress.step:,}/{progress.steps:,}"]
        if progress.success_rate is not None:
            parts.append(f"success {100 * progress.success_rate:.0f} %")
        if progress.episode_return is not None:
            parts.append(f"return {progress.episode_return:.1f}")
        if progress.loss is not None:
            parts.append(f"loss {progress.loss:.4f}")
        if progress.samples_per_s is not None:
            parts.append(f"{progress.samples_per_s:.0f} samples/s")
        if progress.eta_s is not None:
            parts.append(f"{_duration(progress.eta_s)} left")
        self._bar.update(self._task, completed=progress.fraction, description="  ".join(parts))

    def on_end(self, result: TrainResult) -> None:
        """Takes the bar away."""
        self.close()

    def close(self) -> None:
        """Gives the terminal back; also to be called when the run fails."""
        self._bar.stop()


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"

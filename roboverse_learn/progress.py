"""Progress of a long stage: a bar in a terminal; elsewhere a line every 15 s and one at the end."""

import logging
import threading
import time
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from rich.console import Console

INTERVAL_S = 15.0
"""Time between two lines."""

_LEAST_S = 0.1
"""Time after which a rate is shown: what ends at once has none that means anything."""

log = logging.getLogger(__name__)


class StageProgress:
    """Shows how far a stage is, from its ``with`` statement on.

    The lines are logged, so that a run's log has them, too. In a terminal, which has the bar, they are logged
    at the level DEBUG.

    Args:
        stage: What is done, such as ``"collecting"``.
        console: Console to print to; None takes the standard output.
        interval_s: Time between two lines; None takes :data:`INTERVAL_S`.
    """

    def __init__(self, stage: str, console: "Console | None" = None, interval_s: float | None = None) -> None:
        from rich import progress

        self._bar = progress.Progress(
            progress.TextColumn(stage),
            progress.BarColumn(),
            progress.TextColumn("{task.description}"),
            progress.TimeElapsedColumn(),
            console=console,
        )
        self.console = self._bar.console
        self._task = self._bar.add_task("", total=None)
        self._stage, self._interval_s = stage, INTERVAL_S if interval_s is None else interval_s
        self._level = logging.DEBUG if self.console.is_terminal else logging.INFO
        self._description = ""
        self._first: tuple[float, float] | None = None  # what was done, and when, at the first update
        self._ended = threading.Event()
        self._speaker = threading.Thread(target=self._speak, daemon=True)

    def update(
        self,
        done: float,
        total: float,
        text: str = "",
        left_s: float | None = None,
        fraction: float | None = None,
        unit: str = "",
    ) -> None:
        """Takes how far the stage is.

        Args:
            done: How much is done.
            total: How much there is.
            text: What else to show.
            left_s: Seconds left; estimated if None.
            fraction: Share of the stage that is done, where ``done`` is not all that ends it, as with a time
                limit.
            unit: What is counted, such as ``episodes``: shows how many a second.
        """
        fraction = done / max(total, 1) if fraction is None else fraction
        now = time.monotonic()
        self._first = self._first or (done, now)
        already, since = self._first
        parts = [f"{done:,.0f}/{total:,.0f} ({100 * fraction:.0f} %)", text]
        if done > already:
            each_s = (now - since) / (done - already)
            left_s = each_s * max(total - done, 0) if left_s is None else left_s
            if unit and now - since >= _LEAST_S:
                rate = 1 / each_s
                parts.append(f"{rate:,.0f} {unit}/s" if rate >= 100 else f"{rate:.3g} {unit}/s")
        if left_s is not None:
            parts.append(f"{clock(left_s)} left")
        self._description = ", ".join(filter(None, parts))
        self._bar.update(self._task, completed=fraction, total=1.0, description=self._description)

    def print(self, line: str) -> None:
        """Prints a line above the bar."""
        self.console.print(line)

    def __enter__(self) -> Self:
        self._started = time.monotonic()
        if self.console.is_terminal:
            self._bar.start()
        self._speaker.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._bar.stop()
        self._speaker.join()
        if self._description:  # a short stage has no other line
            self._log_line()

    def _speak(self) -> None:
        while not self._ended.wait(self._interval_s):
            self._log_line()

    def _log_line(self) -> None:
        elapsed = clock(time.monotonic() - self._started)
        log.log(self._level, "%s %s, %s elapsed", self._stage, self._description or "starts", elapsed)


def clock(seconds: float) -> str:
    """``75`` as ``1:15``, ``3700`` as ``1:01:40``."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"

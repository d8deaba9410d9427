"""Ctrl-C and SIGTERM, as a scheduler of jobs sends it: training ends after a step, with a checkpoint."""

import contextlib
import signal
import threading
from collections.abc import Iterator

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupted(KeyboardInterrupt):
    """A signal interrupted the process.

    Args:
        number: The signal.

    Attributes:
        exit_code: What a shell reports of a process that the signal ended.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.exit_code = 128 + number


class Interruption:
    """Whether training is to end: false until a signal arrives.

    Attributes:
        signal: The first signal, or None.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self._came = False

    def __bool__(self) -> bool:
        return self.signal is not None

    def hear(self, number: int, _frame: object = None) -> None:
        """Notes a signal to this process; the second one raises at once, without waiting for a step."""
        if self._came:
            raise Interrupted(number)
        self._came, self.signal = True, number

    def hear_of_others(self) -> None:
        """Notes a signal to another of several processes; one to this process may still come."""
        if self.signal is None:
            self.signal = signal.SIGTERM


@contextlib.contextmanager
def signals_noted() -> Iterator[Interruption]:
    """Notes SIGINT and SIGTERM instead of raising in the middle of a step, and raises at the end.

    Outside the main thread, where Python gets no signals, it does nothing. A signal that the process
    ignores, as one in the background does, stays ignored.

    Raises:
        Interrupted: at the end, if a signal arrived, and at once for the second.
    """
    interruption = Interruption()
    before = {}
    if threading.current_thread() is threading.main_thread():
        handlers = {number: signal.getsignal(number) for number in _SIGNALS}
        before = {n: handler for n, handler in handlers.items() if handler not in (signal.SIG_IGN, None)}
    try:
        for number in before:
            signal.signal(number, interruption.hear)
        yield interruption
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if interruption.signal is not None:
        raise Interrupted(interruption.signal)

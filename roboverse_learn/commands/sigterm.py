"""SIGTERM, as a scheduler of jobs sends it: a command ends as by Ctrl-C, with a line and exit code 143.

While an agent or a network is trained, :mod:`roboverse_learn.training.interruption` has the signal instead.
"""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator

from roboverse_learn.training.interruption import Interrupted


@contextlib.contextmanager
def sigterm_interrupts() -> Iterator[None]:
    """Raises :class:`Interrupted` where SIGTERM arrives inside the block, so that everything is cleaned up.

    Outside the main thread, where Python gets no signals, it does nothing. A signal that the process ignores
    stays ignored, and a handler of somebody else's stays. A process that was forked ends at once.
    """
    in_main_thread = threading.current_thread() is threading.main_thread()
    if not in_main_thread or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    process = os.getpid()

    def interrupt(number: int, _frame: object) -> None:
        if os.getpid() == process:
            raise Interrupted(number)
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)

    signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)

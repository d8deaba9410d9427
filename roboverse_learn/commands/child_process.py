"""A process that ends when the one that started it does, however that ends: by Ctrl-C, a crash or SIGKILL.

Its standard input is a pipe that only its parent can write to, so the system closes it with the parent.
"""

import os
import signal
import subprocess
import threading
from collections.abc import Mapping, Sequence
from typing import BinaryIO

_WATCHES = "ROBOVERSE_ENDS_WITH_PARENT"


class Children:
    """Processes that threads of this one wait for, and that another thread can end.

    Each has a process group of its own. A signal to this one's group, as Slurm and a terminal send it,
    reaches them by :meth:`end` alone: a second SIGTERM would end training without a checkpoint.
    """

    def __init__(self) -> None:
        self._running: set[subprocess.Popen[bytes]] = set()
        self._lock = threading.Lock()
        self._ended = False

    def run(self, words: Sequence[str], output: BinaryIO, environment: Mapping[str, str]) -> int:
        """Runs a program that calls :func:`end_with_parent`; returns its exit code.

        Args:
            words: The program and its arguments.
            output: File that gets what it prints, errors too.
            environment: All of its environment variables.
        """
        with self._lock:
            if self._ended:
                return -signal.SIGTERM
            process = subprocess.Popen(
                words,
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**environment, _WATCHES: "1"},
                process_group=0,
            )
            self._running.add(process)
        with process:
            code = process.wait()
        with self._lock:
            self._running.remove(process)
        return code

    def end(self) -> None:
        """Sends SIGTERM to those that run, and lets no other start.

        Windows has no such groups and no SIGTERM of another process: there Ctrl-C reaches them by itself.
        """
        with self._lock:
            self._ended = True
            for process in self._running if os.name != "nt" else ():
                process.terminate()


def end_with_parent() -> None:
    """Ends this process, as SIGTERM does, when the one that started it by :class:`Children` is gone."""
    if os.environ.pop(_WATCHES, ""):  # not for the processes that this one starts
        threading.Thread(target=_watch, daemon=True).start()


def _watch() -> None:
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)

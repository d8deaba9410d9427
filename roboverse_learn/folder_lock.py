"""Lock of a folder that one process writes, on every operating system."""

import logging
from pathlib import Path

from filelock import BaseFileLock, FileLock, Timeout

from envs.core.atomic import write_errors
from envs.core.errors import LockedError

LOCK = ".lock"

log = logging.getLogger(__name__)


def lock_directory(root: Path, *, wait: bool = False) -> BaseFileLock:
    """Makes this process the only writer of a folder; the system releases the lock when the process ends.

    Args:
        root: The folder, which must exist.
        wait: Wait for the other process instead of raising.

    Returns:
        The lock, which its ``release`` opens.

    Raises:
        LockedError: Another process writes to this folder.
        WriteError: The folder cannot be written.
    """
    lock = FileLock(root / LOCK, thread_local=False)
    try:
        with write_errors(root):
            lock.acquire(timeout=0)
    except Timeout as error:
        if not wait:
            raise LockedError(
                f"Another process is writing to '{root}'. Wait until it has finished, or choose another "
                "folder."
            ) from error
        log.info("Another process is writing to '%s'; waiting until it has finished.", root)
        try:
            lock.acquire()
        except FileNotFoundError:  # the other process failed and removed the folder that it had made
            with write_errors(root):
                root.mkdir(parents=True, exist_ok=True)
            return lock_directory(root, wait=True)
    return lock

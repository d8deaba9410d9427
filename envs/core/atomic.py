"""Files that are either complete or absent, whatever kills the process that writes them.

Every file of a dataset is written under a temporary name, flushed to the disk, and renamed; a reader
never sees half of one. A full disk becomes a :class:`DatasetError` and leaves nothing behind.
"""

import contextlib
import errno
import json
import logging
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from envs.core.errors import DatasetError

TEMPORARY_SUFFIX = ".partial"

_DISK_FULL = (errno.ENOSPC, errno.EDQUOT)

log = logging.getLogger(__name__)


@contextlib.contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turns a full disk or a forbidden folder into an error for people.

    Args:
        path: The file being written, named in the message.

    Raises:
        DatasetError: The disk (or the quota) is full, or the folder may not be written.
    """
    try:
        yield
    except PermissionError as error:
        raise DatasetError(
            f"Cannot write '{path}': permission denied. Choose a folder that you may write to."
        ) from error
    except OSError as error:
        if error.errno not in _DISK_FULL:
            raise
        raise DatasetError(
            f"The disk is full: '{path}' could not be written. Nothing was left half-written; every episode "
            "committed before is safe. Free some space and run the same command again."
        ) from error


def write_file(path: Path, content: bytes) -> None:
    """Writes a file atomically: temporary name, fsync, rename.

    Args:
        path: Where the file belongs; missing parent folders are created.
        content: All of its bytes.

    Raises:
        DatasetError: The disk is full or the folder may not be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY_SUFFIX}")
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with open(temporary, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


def write_json(path: Path, value: Any) -> None:
    """Writes a JSON file atomically, indented as LeRobot indents its own."""
    write_file(path, json.dumps(value, indent=4, ensure_ascii=False).encode())


def read_json(path: Path) -> Any:
    """Reads a JSON file.

    Raises:
        DatasetError: The file is absent or is not JSON.
    """
    try:
        return json.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise DatasetError(f"'{path}' does not exist. {RESTORE}") from error
    except (ValueError, UnicodeDecodeError) as error:
        raise broken_file(path, str(error)) from error


RESTORE = "Restore it from a copy, or delete the dataset's folder and collect it again."


def broken_file(path: Path, reason: str) -> DatasetError:
    """Builds the error for a dataset file that cannot be read to its end."""
    return DatasetError(f"'{path}' is truncated or damaged ({reason}). {RESTORE}")


def link_file(source: Path, target: Path) -> None:
    """Gives a complete file a second name, atomically; copies where the file system has no hard links.

    Args:
        source: A complete file.
        target: The new name; an older file of that name is replaced.
    """
    temporary = target.with_name(f".{target.name}.{os.getpid()}{TEMPORARY_SUFFIX}")
    with disk_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary.unlink(missing_ok=True)
        try:
            os.link(source, temporary)
        except OSError as error:
            if error.errno in _DISK_FULL:
                raise
            write_file(target, source.read_bytes())
            return
        os.replace(temporary, target)


def remove_partial_files(root: Path) -> None:
    """Deletes what killed writers left under a temporary name, anywhere below ``root``."""
    for path in root.rglob(f".*{TEMPORARY_SUFFIX}"):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def lock_directory(root: Path, *, wait: bool = False) -> int:
    """Takes the one writer's place of a dataset; the system gives it back when the process dies.

    Args:
        root: The dataset's folder, which must exist.
        wait: Wait for the other process instead of raising.

    Returns:
        The lock's file descriptor; ``os.close`` releases it.

    Raises:
        DatasetError: Another process is writing this dataset.
    """
    import fcntl

    with disk_errors(root):
        descriptor = os.open(root / ".lock", os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if wait:
            log.info("Another process is writing the dataset '%s'; waiting until it has finished.", root)
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            return descriptor
        os.close(descriptor)
        raise DatasetError(
            f"Another process is writing the dataset '{root}'. Wait until it has finished, or choose "
            "another folder."
        ) from error
    return descriptor

"""Folders that appear complete or not at all."""

import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def fsync(path: Path) -> None:
    """Flushes a file, or the entries of a folder, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def atomic_directory(directory: str | Path) -> Iterator[Path]:
    """Yields an empty folder beside ``directory`` and renames it to ``directory`` at the end.

    Every file is flushed to the disk before the rename. If the block raises, what was written is
    removed and ``directory`` is as it was. A process that is killed leaves a folder whose name begins
    with a dot and ends in ``.partial``, which nothing reads.
    """
    directory = Path(directory)
    directory.parent.mkdir(parents=True, exist_ok=True)
    staging = directory.parent / f".{directory.name}.{uuid.uuid4().hex[:8]}.partial"
    staging.mkdir()
    try:
        yield staging
        for path in sorted(staging.rglob("*"), reverse=True):
            fsync(path)
        fsync(staging)
        _replace(staging, directory)
        fsync(directory.parent)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _replace(staging: Path, directory: Path) -> None:
    """Renames ``staging`` to ``directory``; a folder of that name moves away first."""
    if not directory.exists():
        os.rename(staging, directory)
        return
    old = staging.with_suffix(".old.partial")
    os.rename(directory, old)
    try:
        os.rename(staging, directory)
    except OSError:
        os.rename(old, directory)
        raise
    shutil.rmtree(old, ignore_errors=True)

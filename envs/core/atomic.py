"""Files and folders that are either complete or absent, even if the process that writes them is killed.

Each is written under a temporary name beside its place, flushed to the disk, and renamed. Nothing reads a
temporary name; :func:`remove_partial_files` deletes what killed processes left, and puts back a folder that
one of them had set aside for its successor.
"""

import contextlib
import errno
import json
import os
import re
import shutil
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from envs.core.errors import RoboVerseError, WriteError

PARTIAL = ".partial"

_SET_ASIDE = f".old{PARTIAL}"
"""The suffix of a folder that makes room for its successor."""


def partial_path(path: Path, *, keep_suffix: bool = False) -> Path:
    """Returns a new temporary name beside ``path``.

    Args:
        path: What will be written.
        keep_suffix: End in the suffix of ``path``, for a library that chooses a format by it.
    """
    suffix = path.suffix if keep_suffix else ""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}{PARTIAL}{suffix}")


def remove_partial_files(root: Path) -> None:
    """Deletes what killed processes left under a temporary name, anywhere below ``root``.

    A folder whose successor did not take its place is put back.
    """
    for path in list(root.rglob(f".*{PARTIAL}*")):
        set_aside = re.fullmatch(rf"\.(.+)\.[0-9a-f]{{8}}{re.escape(_SET_ASIDE)}", path.name)
        if set_aside and not (place := path.with_name(set_aside[1])).exists():
            path.rename(place)
        elif path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


@contextlib.contextmanager
def write_errors(path: Path) -> Iterator[None]:
    """Turns the system error of a full disk or a forbidden folder into a :class:`WriteError`.

    Args:
        path: What is being written, for the message.

    Raises:
        WriteError: Nothing could be written; the message says why.
    """
    try:
        yield
    except RoboVerseError:
        raise
    except Exception as error:
        foreign = re.search(r"\(os error (\d+)\)", str(error))  # of libraries in Rust, such as safetensors
        code = int(foreign[1]) if foreign else getattr(error, "errno", None)
        if not isinstance(code, int) or not (foreign or isinstance(error, OSError)):
            raise
        why = "the disk is full" if code in (errno.ENOSPC, errno.EDQUOT) else os.strerror(code)
        if isinstance(error, OSError) and (wrong := folder_for_file(error) or file_for_folder(error)):
            raise WriteError(wrong) from error
        # The message names the final path, also of what is written into a temporary folder.
        final = re.sub(rf"\.([^/]+)\.[0-9a-f]{{8}}{re.escape(PARTIAL)}", r"\1", str(path))
        raise WriteError(
            f"'{final}' could not be written: {why}. What was complete before is unchanged. Free some space "
            "or choose a folder that you may write to, and run the same command again."
        ) from error


def folder_for_file(error: OSError) -> str:
    """Returns what to say of a system error where a folder is in the place of a file; empty for any other."""
    path = error.filename2 or error.filename
    if error.errno != errno.EISDIR or not isinstance(path, str | os.PathLike):
        return ""
    return (
        f"'{os.fspath(path)}' is a folder, where a file belongs. If you named it, name a file; else move it "
        "away, or restore the file from a copy, and run the same command again."
    )


def file_for_folder(error: OSError) -> str:
    """Returns what to say of a system error where a file is in the place of a folder; empty for any other."""
    if error.errno not in (errno.ENOTDIR, errno.EEXIST) or not isinstance(error.filename, str | os.PathLike):
        return ""
    file = file_in_place_of_folder(Path(error.filename))
    return not_a_folder(file) if file else ""


def file_in_place_of_folder(path: Path) -> Path | None:
    """Returns the file at ``path`` or above it, which keeps ``path`` from being a folder."""
    return next((each for each in (path, *path.parents) if each.exists() and not each.is_dir()), None)


def not_a_folder(file: Path) -> str:
    """Returns the message for a file where a folder is meant."""
    return f"'{file}' is a file, not a folder. Name another folder, or move the file away."


@contextlib.contextmanager
def atomic_path(path: Path, *, keep_suffix: bool = False) -> Iterator[Path]:
    """Yields a temporary path; the file written there becomes ``path`` if the block ends without an error.

    Args:
        path: The file to write. Its folder is created.
        keep_suffix: See :func:`partial_path`.

    Raises:
        WriteError: The disk is full or the folder cannot be written.
    """
    temporary = partial_path(path, keep_suffix=keep_suffix)
    with write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            fsync(temporary)
            os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


def write_file(path: Path, content: bytes) -> None:
    """Writes a file; see :func:`atomic_path`."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def write_json(path: Path, value: Any) -> None:
    """Writes a JSON file, indented as LeRobot indents its own; see :func:`atomic_path`."""
    write_file(path, json.dumps(value, indent=4, ensure_ascii=False).encode())


def link_file(source: Path, target: Path) -> None:
    """Gives a complete file a second name; copies it where the file system has no hard links.

    Args:
        source: A complete file.
        target: The new name; an older file of that name is replaced.

    Raises:
        WriteError: The disk is full or the folder cannot be written.
    """
    temporary = partial_path(target)
    with write_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(source, temporary)
        except OSError:
            write_file(target, source.read_bytes())
        else:
            os.replace(temporary, target)


@contextlib.contextmanager
def atomic_directory(directory: str | Path) -> Iterator[Path]:
    """Yields a new folder; it becomes ``directory``, with all in it, if the block ends without an error.

    Args:
        directory: The folder to write. One of that name is replaced, and kept if the block raises.

    Raises:
        WriteError: The disk is full or the folder cannot be written.
    """
    directory = Path(directory)
    staging = partial_path(directory)
    with write_errors(directory):
        staging.mkdir(parents=True)
        try:
            yield staging
            for path in (*sorted(staging.rglob("*"), reverse=True), staging):
                fsync(path)
            old = staging.with_name(f"{staging.name.removesuffix(PARTIAL)}{_SET_ASIDE}")
            if directory.exists():
                os.rename(directory, old)
            try:
                os.rename(staging, directory)
            except OSError:
                if old.exists():
                    os.rename(old, directory)
                raise
            fsync(directory.parent)
            shutil.rmtree(old, ignore_errors=True)
        finally:
            shutil.rmtree(staging, ignore_errors=True)


@contextlib.contextmanager
def cached_directory(directory: Path) -> Iterator[Path]:
    """Yields a new folder, which becomes ``directory`` unless another process has made that one meanwhile.

    Nothing is flushed to the disk: what is cached can be made again.
    """
    staging = partial_path(directory)
    staging.mkdir(parents=True)
    try:
        yield staging
        try:
            os.rename(staging, directory)
        except OSError:
            if not directory.is_dir():
                raise
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def fsync(path: Path) -> None:
    """Flushes a file, or the names in a folder, to the disk; Windows does not open folders."""
    if os.name == "nt" and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

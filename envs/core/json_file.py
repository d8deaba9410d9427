"""Files of kept values that may be absent: what was measured, and what is added to."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from envs.core.errors import ConfigError


def read_kept[T](path: Path, parse: Callable[[Any], T], wrong: str, remedy: str) -> T | None:
    """Returns what a JSON file says; None if there is no file.

    Args:
        path: The file.
        parse: Makes the result of the file's values; what they lack ends in an error of lookup or type.
        wrong: What is wrong with another file, such as ``"has no rows of tasks"``.
        remedy: What to do then.

    Raises:
        ConfigError: The file is damaged.
    """
    if not path.is_file():
        return None
    try:
        return parse(json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{path} {wrong} ({type(error).__name__}: {error}). {remedy}") from error

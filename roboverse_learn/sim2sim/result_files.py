"""Reads and writes JSON results, one file each, in a folder of their own."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from envs.core.atomic import write_file
from envs.core.errors import ResultError


def write_json_result(path: Path, values: Mapping[str, Any]) -> None:
    """Writes a result atomically, numbers with seven significant digits.

    Raises:
        ResultError: The file cannot be written.
    """
    text = json.dumps(_rounded(values), indent=1, sort_keys=True, allow_nan=False)
    # A list of numbers takes one line.
    text = re.sub(r"\[\s+([-\d.e,\s]+?)\s+\]", lambda m: "[" + " ".join(m[1].split()) + "]", text)
    write_file(path, (text + "\n").encode())


def read_json_results(folder: Path, keys: set[str], what: str) -> list[dict[str, Any]]:
    """Reads every JSON file of a folder, ordered by name.

    Args:
        folder: The folder.
        keys: Keys that every result has.
        what: What a result is, for messages, such as ``"summary of a replay"``.

    Raises:
        ResultError: A file is not such a result.
    """
    results = []
    for path in sorted(folder.glob("*.json")):
        try:
            values = json.loads(path.read_bytes())
        except ValueError as error:
            raise ResultError(f"'{path}' is not a JSON file: {error}. Remove it and run again.") from error
        if not isinstance(values, dict) or not set(values) >= keys:
            raise ResultError(
                f"'{path}' is no {what}. Keep other files out of '{folder}', or choose another folder with "
                "out=<folder>."
            )
        results.append(values)
    return results


def _rounded(values: Any) -> Any:
    """Rounds to seven significant digits: what is below differs between machines."""
    if isinstance(values, float):
        return float(f"{values:.7g}")
    if isinstance(values, Mapping):
        return {key: _rounded(value) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [_rounded(value) for value in values]
    return values

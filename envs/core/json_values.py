"""Converts frozen data to values of JSON and YAML: dictionaries, lists, texts and numbers."""

from collections.abc import Collection, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any


def to_json_values(value: Any) -> Any:
    """Returns dataclasses as dictionaries, tuples as lists and paths as strings, however deep they lie."""
    if is_dataclass(value):
        return {item.name: to_json_values(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): to_json_values(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [to_json_values(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def flat(values: Mapping[str, Any], prefix: str = "", leaves: Collection[str] = ()) -> dict[str, Any]:
    """Returns nested values by dotted key; the mappings at the keys ``leaves`` are values themselves."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        key = f"{prefix}{name}"
        nested = isinstance(value, Mapping) and key not in leaves
        found |= flat(value, f"{key}.", leaves) if nested else {key: value}
    return found

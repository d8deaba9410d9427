"""A short name for how an episode begins and looks."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any

import numpy as np
import torch

from envs.scenario import Appearance
from envs.state import State

_PICTURE_SIZE = ("width", "height")


def episode_digest(state: State, appearance: Appearance) -> str:
    """Returns the first 16 hex digits of a SHA-256 of a state of one environment and of its looks.

    What is hashed are values under their names, without those that are a field's default. A field that is
    added later, with a default that changes nothing, leaves the hashes of episodes as they were. The size
    of a picture is no part of an episode.
    """
    sha = hashlib.sha256()
    for key, value in sorted(state.flatten().items()):
        sha.update(key.encode())
        numbers = torch.as_tensor(value).cpu().double().numpy()
        sha.update(np.ascontiguousarray(numbers, "<f8").tobytes())
    looks = named_values(appearance)
    for camera in looks.get("cameras", {}).values():
        for name in _PICTURE_SIZE:
            camera.pop(name, None)
    sha.update(json.dumps(looks, sort_keys=True, separators=(",", ":"), allow_nan=False).encode())
    return sha.hexdigest()[:16]


def named_values(value: Any) -> Any:
    """Returns frozen data as plain JSON values: of a dataclass, the fields that are not their defaults."""
    if is_dataclass(value) and not isinstance(value, type):
        given = ((field, getattr(value, field.name)) for field in fields(value))
        return {field.name: named_values(v) for field, v in given if not _is_default(field, v)}
    if isinstance(value, Mapping):
        return {str(key): named_values(part) for key, part in value.items()}
    if isinstance(value, tuple | list):
        return [named_values(part) for part in value]
    return value.item() if isinstance(value, np.generic) else value


def _is_default(field: Field, value: Any) -> bool:
    if field.default is not MISSING:
        return bool(value == field.default)
    return field.default_factory is not MISSING and bool(value == field.default_factory())

"""A hash of the initial state and the appearance of an episode."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any

import numpy as np
import torch

from envs.scenario import Appearance
from envs.state import State

_IMAGE_SIZE = ("width", "height")


def episode_digest(state: State, appearance: Appearance) -> str:
    """Returns the first 16 hex digits of the SHA-256 of one environment's state and appearance.

    Values are hashed with their names; fields with their default value are left out. So a field that is
    added later, with a default that changes nothing, changes no hash. The image size has no influence.
    """
    sha = hashlib.sha256()
    for key, value in sorted(state.flatten().items()):
        sha.update(key.encode())
        numbers = torch.as_tensor(value).cpu().double().numpy()
        sha.update(np.ascontiguousarray(numbers, "<f8").tobytes())
    looks = named_values(appearance)
    for camera in looks.get("cameras", {}).values():
        for name in _IMAGE_SIZE:
            camera.pop(name, None)
    sha.update(json.dumps(looks, sort_keys=True, separators=(",", ":"), allow_nan=False).encode())
    return sha.hexdigest()[:16]


def named_values(value: Any) -> Any:
    """Returns frozen data as JSON values; dataclass fields with their default value are left out."""
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

"""Hashes that name runs and results: of plain values, and of files."""

import hashlib
import json
from pathlib import Path
from typing import Any


def canonical_json(values: Any) -> str:
    """Returns the one JSON text of ``values``: sorted keys, no spaces, no NaN."""
    return json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=False)


def fingerprint(values: Any) -> str:
    """Returns the SHA-256 of the canonical JSON, 64 hexadecimal digits."""
    return hashlib.sha256(canonical_json(values).encode()).hexdigest()


def digest(values: Any) -> str:
    """Returns the first 8 digits of the fingerprint: what names files."""
    return fingerprint(values)[:8]


def file_hash(path: Path) -> str:
    """Returns the SHA-256 of a file, such as a checkpoint's ``model.safetensors``."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()

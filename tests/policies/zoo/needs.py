"""Marks that skip a test where a package that it needs is not installed."""

from importlib.util import find_spec
from typing import Any

import pytest

from policies.zoo.preflight import packages_of_type

OPENVLA = ("transformers", "timm")
"""What OpenVLA needs, without adapters."""


def needs(*packages: str) -> pytest.MarkDecorator:
    """Skips a test where one of the modules is not installed."""
    missing = [name for name in packages if find_spec(name) is None]
    reason = f"needs {' and '.join(missing)} of the extra vla: uv pip install -e '.[vla]'"
    return pytest.mark.skipif(bool(missing), reason=reason)


def of_type(name: str) -> Any:
    """Returns a LeRobot policy type as a parameter, skipped where a package that it needs is missing."""
    return pytest.param(name, marks=needs(*packages_of_type(name)))


def of_types(*names: str) -> list[Any]:
    """Returns several types as parameters, each with its own mark."""
    return [of_type(name) for name in names]

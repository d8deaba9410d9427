"""Units of every part of a scenario: metres, kilograms, radians unless a name says ``_deg``.

And what the text of a part can stand for.
"""

from typing import Annotated

Vec3 = tuple[float, float, float]
Rgba = tuple[float, float, float, float]
"""Linear colour in [0, 1], and opacity."""

Quat = tuple[float, float, float, float]
"""Unit quaternion (w, x, y, z)."""

IDENTITY: Quat = (1.0, 0.0, 0.0, 0.0)

AssetRef = Annotated[str, "asset"]
"""A file: a path, or ``"package:path/inside/package"``."""

MaterialName = Annotated[str, "material"]
"""A material of the library, such as ``"wood-017"``."""

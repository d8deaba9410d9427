"""Conversion of robots from MJCF to URDF and USD.

Everything is read from MuJoCo's compiled model, which has already resolved defaults, includes, frames and
angle units.
"""

from envs.convert.conversion import FORMATS, convert
from envs.convert.source import Source

__all__ = ["FORMATS", "Source", "convert"]

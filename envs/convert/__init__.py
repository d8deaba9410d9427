"""One robot, one description: MJCF, from which URDF and USD are made when something needs them.

Everything is read from MuJoCo's compiled model, so that defaults, includes, frames and angles of a file need
no second interpretation.
"""

from envs.convert.conversion import FORMATS, convert
from envs.convert.source import Source

__all__ = ["FORMATS", "Source", "convert"]

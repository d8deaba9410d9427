"""Cubes, targets and measures that ManiSkill's tasks share."""

from torch import Tensor

from envs.array_ops import norm
from envs.scenario import GeomCfg, ObjectCfg, Rgba
from envs.state import EntityState
from envs.tasks.tabletop import DENSITY_KG_M3

CUBE_HALF_SIZE_M = 0.02
BLUE: Rgba = (12 / 255, 42 / 255, 160 / 255, 1.0)
RED: Rgba = (0.85, 0.08, 0.08, 1.0)
GREEN: Rgba = (0.08, 0.7, 0.12, 1.0)
WHITE: Rgba = (0.93, 0.93, 0.93, 1.0)

GOAL_Z_M = 1e-3
"""Height of a target's disc on the table."""

STATIC_SPEED_M_S, STATIC_SPEED_RAD_S = 1e-2, 0.5
"""Limits of an object that is still (``utils/structs/actor.py``, ``is_static``)."""

_RINGS = 5


def box(
    half: tuple[float, float, float],
    rgba: Rgba,
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0),
    density: float = DENSITY_KG_M3,
) -> GeomCfg:
    """Returns a box with the mass of its volume."""
    mass = 8.0 * half[0] * half[1] * half[2] * density
    return GeomCfg(shape="box", size=half, pos=pos, rgba=rgba, mass_kg=mass)


def cube(name: str, half_m: float, rgba: Rgba) -> ObjectCfg:
    """Returns a cube on the table."""
    return ObjectCfg(name=name, geoms=(box((half_m, half_m, half_m), rgba),), pos=(0.0, 0.0, half_m))


def target(name: str, radius_m: float) -> ObjectCfg:
    """Returns a red and white disc on the table, which marks a goal."""
    rings = tuple(
        GeomCfg(
            shape="cylinder",
            size=(radius_m * (1.0 - ring / _RINGS), 2e-4),
            pos=(0.0, 0.0, 4e-4 * ring),
            rgba=WHITE if ring % 2 else RED,
        )
        for ring in range(_RINGS)
    )
    return ObjectCfg(name=name, geoms=rings, pos=(0.0, 0.0, GOAL_Z_M), kind="marker")


def is_still(item: EntityState) -> Tensor:
    """Returns whether an object is still, (N,)."""
    return (norm(item.lin_vel) <= STATIC_SPEED_M_S) & (norm(item.ang_vel) <= STATIC_SPEED_RAD_S)

"""robosuite's hammer (``models/objects/composite/hammer.py``, MIT): handle along z, head at its upper end."""

import math
from dataclasses import dataclass

import numpy as np

from envs.array_ops import Array
from envs.rotations import multiply, rotate
from envs.scenario import GeomCfg, ObjectCfg, Quat, Rgba, Vec3
from envs.state import EntityState
from envs.tasks.arm_at_table import Start
from envs.tasks.tabletop import direction_of

_WOOD: Rgba = (0.72, 0.55, 0.36, 1.0)
_METAL: Rgba = (0.5, 0.5, 0.52, 1.0)
_ACROSS: Quat = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
_CLAW: Quat = (0.9238795, 0.0, 0.3826834, 0.0)

LYING = (np.array([0.5, -0.5, 0.5, -0.5]), np.array([-0.5, -0.5, -0.5, -0.5]))
"""The two ways to lie, ``init_quat``; the sampler takes them for wxyz, and turns about the vertical."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Hammer:
    """Sizes of a hammer.

    Attributes:
        radius_m: Half the width of its square handle.
        length_m: Length of the handle.
        density: Density of the handle, kg/m³.
        head_density_ratio: Density of the head over the handle's.
        friction: Sliding friction of the handle.
    """

    radius_m: float
    length_m: float
    density: float
    head_density_ratio: float
    friction: float

    @property
    def head_m(self) -> float:
        """Half the thickness of the head: robosuite draws 1 to 1.2 of the handle's, here the middle."""
        return 1.1 * self.radius_m

    def as_object(self, name: str, feels: tuple[str, ...] = ()) -> ObjectCfg:
        """Returns the hammer as an object."""
        r, half, h = self.radius_m, self.length_m / 2, self.head_m
        z, dense = half + h, self.density * self.head_density_ratio
        handle = GeomCfg(
            shape="box",
            size=(r, r, half),
            rgba=_WOOD,
            mass_kg=8.0 * r * r * half * self.density,
            friction=(self.friction, 0.005, 0.0001),
        )
        boxes = (
            ((2 * h, h, h), (0.0, 0.0, z), (1.0, 0.0, 0.0, 0.0)),
            ((0.7072 * h, 0.95 * h, 0.7072 * h), (-2 * h, 0.0, z), _CLAW),
        )
        rounds = (((0.8 * h, 0.2 * h), (2.2 * h, 0.0, z)), ((h, 0.4 * h), (2.8 * h, 0.0, z)))
        head = [
            GeomCfg(
                shape="box", size=size, pos=pos, rot=rot, rgba=_METAL, mass_kg=8.0 * math.prod(size) * dense
            )
            for size, pos, rot in boxes
        ]
        head += [
            GeomCfg(
                shape="cylinder",
                size=size,
                pos=pos,
                rot=_ACROSS,
                rgba=_METAL,
                mass_kg=2.0 * math.pi * size[0] ** 2 * size[1] * dense,
            )
            for size, pos in rounds
        ]
        return ObjectCfg(name=name, geoms=(handle, *head), pos=(0.0, 0.0, h), rot=_ACROSS, feels=feels)

    def resting(self, x_m: float, y_m: float, floor_m: float, rot: np.ndarray) -> Start:
        """Returns the start of a hammer that lies at rest: on its thicker head and the handle's end.

        Args:
            x_m: Place of the middle of its handle.
            y_m: Likewise.
            floor_m: Height of what it lies on.
            rot: Orientation in which the handle is level, wxyz, (4,).
        """
        tilt = math.atan((self.head_m - self.radius_m) / self.length_m)
        x, y, _ = rotate(rot, np.array([0.0, 0.0, 1.0]))
        half = math.sin(tilt / 2)
        raised = np.array([math.cos(tilt / 2), half * y, -half * x, 0.0])
        height = self.length_m / 2 * math.sin(tilt) + self.radius_m * math.cos(tilt)
        return Start((x_m, y_m, floor_m + height), rot=multiply(raised, rot))

    def nearest(self, hammer: EntityState, place: Array, beyond_m: float = 0.0) -> Array:
        """Returns the points of handles that are nearest to places (N, 3), m, (N, 3).

        Args:
            hammer: The hammers.
            place: The places.
            beyond_m: How far towards the head points of it count too.
        """
        axis = axis_of(hammer)
        along = ((place - hammer.pos) * axis).sum(-1)
        half = self.length_m / 2
        along = along.clip(-half, half + beyond_m)
        return hammer.pos + along[:, None] * axis

    def height(self, hammer: EntityState) -> Array:
        """Returns robosuite's height of hammers, m, (N,): less the fall of what is beyond the middle."""
        sine = axis_of(hammer)[:, 2].clip(-1.0, 1.0)
        return hammer.pos[:, 2] - self.radius_m - (self.length_m / 2 + 2 * self.head_m) * sine


def axis_of(hammer: EntityState) -> Array:
    """Returns where handles point, to the head, (N, 3)."""
    return direction_of(hammer, (0.0, 0.0, 1.0))


def along(hammer: EntityState, place_m: float) -> np.ndarray:
    """Returns a point of the handle that far from its middle to the head, of a state of one row, m, (3,)."""
    place: Vec3 = (0.0, 0.0, place_m)
    return hammer.pos[0].numpy() + rotate(hammer.rot[0].numpy(), np.array(place))

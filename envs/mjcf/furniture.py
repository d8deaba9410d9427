"""Furniture in a MuJoCo model: visual geoms whose sizes, poses and colours an appearance sets.

Each place of a room has a fixed set of geoms, its slots. An unused slot is a tiny geom below
the floor of its place. A ray tracer's tree is built once for a model, so a slot is never far from there.
"""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from envs.core.errors import ConfigError, unknown_name
from envs.mjcf.objects import SCENE_GROUP, SHAPES
from envs.scenario import GeomCfg
from envs.scenario.places import PLACE_SHAPES, Place, places_of

FURNITURE = "furniture"
"""Prefix of the slots' names, and their segmentation name."""

_UNUSED_HALF_SIZE_M = 0.001
_DEPTH_M = 0.5
_ROT = (0.96, 0.0, 0.0, 0.28)
"""Of an unused slot. Where a geom has its body's pose, MuJoCo never looks at the geom's own."""


def add_furniture_slots(spec: mujoco.MjSpec, half_size_m: float, floor_z: float) -> None:
    """Adds the slots of a room's places."""
    for place in places_of(half_size_m).values():
        for shape, count in PLACE_SHAPES[place.kind].items():
            for index in range(count):
                spec.worldbody.add_geom(
                    name=f"{FURNITURE}_{place.name}/{shape}{index}",
                    type=SHAPES[shape],
                    size=(_UNUSED_HALF_SIZE_M,) * 3,
                    pos=_below(place, floor_z),
                    quat=_ROT,
                    contype=0,
                    conaffinity=0,
                    mass=0.0,
                    group=SCENE_GROUP,
                )


def _below(place: Place, floor_z: float) -> tuple[float, float, float]:
    return (*place.at(0.4, 0.0), floor_z - _DEPTH_M)


class FurnitureSlots:
    """The slots of one model, and their addresses in its arrays.

    Args:
        model: The compiled scene, not yet furnished.

    Attributes:
        geoms: Ids of all slots, (n,).
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        names = [model.geom(index).name for index in range(model.ngeom)]
        self._slots: dict[str, dict[str, list[int]]] = {}
        for index, name in enumerate(names):
            if name.startswith(f"{FURNITURE}_"):
                place, _, slot = name.removeprefix(f"{FURNITURE}_").rpartition("/")
                shape = slot.rstrip("0123456789")
                self._slots.setdefault(place, {}).setdefault(shape, []).append(index)
        self.geoms = np.array(
            [index for shapes in self._slots.values() for ids in shapes.values() for index in ids], np.intp
        )
        self._unused = {name: getattr(model, name)[self.geoms].copy() for name in FIELDS}

    def furnish(self, model: mujoco.MjModel, furniture: Mapping[str, Sequence[GeomCfg]]) -> None:
        """Writes furniture to a copy of the model.

        Raises:
            UnknownNameError: if the room has no such place, or a place no geom of such a shape.
            ConfigError: if a place has too few geoms of a shape.
        """
        for name, values in self._unused.items():
            getattr(model, name)[self.geoms] = values
        for place, geoms in furniture.items():
            if place not in self._slots:
                raise unknown_name("place for furniture in this room", place, self._slots)
            free = {shape: iter(ids) for shape, ids in self._slots[place].items()}
            for geom in geoms:
                if geom.shape not in free:
                    raise unknown_name(f"shape of furniture at '{place}'", geom.shape, free)
                index = next(free[geom.shape], None)
                if index is None:
                    count = len(self._slots[place][geom.shape])
                    raise ConfigError(f"Furniture at '{place}' has at most {count} geoms '{geom.shape}'.")
                model.geom_size[index] = (*geom.size, 0.0, 0.0)[:3]
                model.geom_pos[index], model.geom_quat[index] = geom.pos, geom.rot
                model.geom_rgba[index] = geom.rgba
                model.geom_rbound[index] = np.linalg.norm(geom.size)


FIELDS = ("geom_size", "geom_pos", "geom_quat", "geom_rgba", "geom_rbound")
"""Model fields that furniture changes."""

"""Places for furniture in a room: along its walls and in its corners."""

import math
from dataclasses import dataclass

WALL_HALF_THICKNESS_M = 0.05
"""Half of the thickness of a room's walls."""

PLACE_SHAPES = {"wall": {"box": 8}, "corner": {"box": 6, "cylinder": 3, "sphere": 2}}
"""The most geoms of each shape that furniture may have at a place of a kind."""

_AWAY_FROM_MIDDLE_M = 0.66
"""Of the two places along one wall; a piece is at most twice as wide."""


@dataclass(frozen=True, slots=True)
class Place:
    """A place for one piece of furniture.

    Attributes:
        name: ``"wall<i>/<j>"`` or ``"corner<i>"``.
        x: A point on the wall, or the corner, m.
        y: Likewise.
        yaw_rad: Where it faces: away from the wall, or from the corner to the middle.
    """

    name: str
    x: float
    y: float
    yaw_rad: float

    @property
    def kind(self) -> str:
        """``"wall"`` or ``"corner"``."""
        return self.name.rstrip("0123456789/")

    def at(self, distance_m: float, shift_m: float) -> tuple[float, float]:
        """Returns the point so far from the wall (from both, in a corner), shifted along it."""
        ahead = distance_m * (math.sqrt(2.0) if self.kind == "corner" else 1.0)
        shift = 0.0 if self.kind == "corner" else shift_m
        x = self.x + ahead * math.cos(self.yaw_rad) - shift * math.sin(self.yaw_rad)
        y = self.y + ahead * math.sin(self.yaw_rad) + shift * math.cos(self.yaw_rad)
        return round(x, 9), round(y, 9)


def places_of(half_size_m: float) -> dict[str, Place]:
    """Returns the places of a square room, by name.

    Args:
        half_size_m: Distance of each wall's middle from the origin.
    """
    inside = half_size_m - WALL_HALF_THICKNESS_M
    places = []
    for wall in range(4):
        yaw = wall * math.pi / 2
        for index, along in enumerate((-_AWAY_FROM_MIDDLE_M, _AWAY_FROM_MIDDLE_M)):
            x = -inside * math.cos(yaw) - along * math.sin(yaw)
            y = -inside * math.sin(yaw) + along * math.cos(yaw)
            places.append(Place(f"wall{wall}/{index}", round(x, 9), round(y, 9), yaw))
    for corner in range(4):
        yaw = (corner + 0.5) * math.pi / 2
        x, y = (math.copysign(inside, -part) for part in (math.cos(yaw), math.sin(yaw)))
        places.append(Place(f"corner{corner}", x, y, yaw))
    return {place.name: place for place in places}

"""Furniture of the room: samples pieces and their poses along the walls.

Furniture is visual only: nothing collides with it, and it is placed where it hides no camera's view of
the robot's workspace.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from envs.randomization.camera_poses import CAMERA_POSES
from envs.randomization.furniture_catalogue import IN_CORNER, Piece, layout, piece, shade
from envs.scenario import GeomCfg, ScenarioCfg
from envs.scenario.places import Place, places_of


@dataclass(frozen=True, slots=True)
class Placement:
    """Pose of a piece at a place.

    Attributes:
        place: Name of the place.
        piece: Name of the piece.
        shift_m: Along the wall.
        gap_m: Away from the wall.
        yaw_rad: Turn against the way that the place faces.
        tint: Multiplies its colours.
    """

    place: str
    piece: str
    shift_m: float
    gap_m: float
    yaw_rad: float
    tint: float


@dataclass(frozen=True, slots=True)
class Circle:
    """A part of the floor that stays free: centre and radius, m."""

    x: float
    y: float
    radius: float


def draw_furniture(
    rng: np.random.Generator, layouts: Sequence[str], pieces: Sequence[str]
) -> tuple[str, tuple[Placement, ...]]:
    """Samples a layout, and a piece and its pose for each of the layout's places.

    Args:
        rng: Random numbers of one episode.
        layouts: Names of layouts to choose from.
        pieces: Names of pieces to choose from, some of each kind.
    """
    name = layouts[int(rng.integers(len(layouts)))]
    of_kind: dict[str, list[str]] = {}
    for piece_name in pieces:
        of_kind.setdefault(piece_name.rpartition("-")[0], []).append(piece_name)
    placements = []
    for place, kind in layout(name).items():
        names = of_kind[kind]
        corner = kind in IN_CORNER
        placements.append(
            Placement(
                place=place,
                piece=names[int(rng.integers(len(names)))],
                shift_m=float(rng.uniform(-0.05, 0.05)),
                gap_m=float(rng.uniform(0.0, 0.35 if corner else 0.12)),
                yaw_rad=float(rng.uniform(-0.7, 0.7) if corner else rng.uniform(-0.04, 0.04)),
                tint=float(rng.uniform(0.8, 1.2)),
            )
        )
    return name, tuple(placements)


def keep_free(scenario: ScenarioCfg) -> tuple[Circle, ...]:
    """Returns where no furniture may stand: round the robots, the table, and wherever a camera is placed.

    A camera looks inwards from a circle that is free of furniture, so none of it hides what the robot does.
    """
    reach = max(math.hypot(*pose.pos[:2]) for pose in CAMERA_POSES.values()) + 0.15
    circles = [Circle(robot.pos[0], robot.pos[1], 0.95) for robot in scenario.robots]
    if scenario.table is not None:
        pos, half = scenario.table.pos, scenario.table.half_size
        circles.append(Circle(pos[0], pos[1], math.hypot(*half) + 0.05))
    for camera in scenario.cameras:
        if camera.mount is None:
            middle = camera.orbit_pos
            reached = max(reach, math.dist(camera.pos[:2], middle[:2]) + 0.15)
            circles.append(Circle(middle[0], middle[1], reached))
    return tuple(circles)


def furnish(scenario: ScenarioCfg, placements: Sequence[Placement]) -> dict[str, tuple[GeomCfg, ...]]:
    """Stands furniture in a scenario's room: place to geoms in the world's frame.

    What would reach into the free part of the floor moves to its wall; what does not fit even there, in a
    small room, is left out.
    """
    if scenario.room is None:
        return {}
    places, free = places_of(scenario.room.half_size_m), keep_free(scenario)
    standing: list[_Standing] = []
    for placement in placements:
        for gap in (placement.gap_m, 0.0):
            placed = _Standing.of(places[placement.place], placement, gap)
            if placed.fits(free, standing):
                standing.append(placed)
                break
    return {item.placement.place: item.geoms(scenario.floor_z) for item in standing}


@dataclass(frozen=True, slots=True)
class _Standing:
    """A piece on the floor: position of its middle, m, and yaw."""

    placement: Placement
    item: Piece
    x: float
    y: float
    yaw_rad: float
    corner: bool

    @classmethod
    def of(cls, place: Place, placement: Placement, gap_m: float) -> "_Standing":
        """Puts a piece so far from the wall that no turn brings it into the wall."""
        item, corner = piece(placement.piece), place.kind == "corner"
        depth = item.half_depth_m + abs(math.sin(placement.yaw_rad)) * item.half_width_m
        reach = item.radius if corner else depth
        x, y = place.at(reach + gap_m + 0.01, placement.shift_m)
        return cls(placement, item, x, y, place.yaw_rad + placement.yaw_rad, corner)

    def fits(self, free: Sequence[Circle], others: Sequence["_Standing"]) -> bool:
        """Whether it reaches neither into what stays free nor, in a corner, into another piece."""
        own = Circle(self.x, self.y, self.item.radius)
        return all(map(self.clear_of, free)) and not (
            self.corner and any(not other.clear_of(own) for other in others)
        )

    def clear_of(self, circle: Circle) -> bool:
        """Whether its footprint does not reach into a circle."""
        along, across = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        dx, dy = circle.x - self.x, circle.y - self.y
        outside_x = max(0.0, abs(along * dx + across * dy) - self.item.half_depth_m)
        outside_y = max(0.0, abs(along * dy - across * dx) - self.item.half_width_m)
        return math.hypot(outside_x, outside_y) >= circle.radius

    def geoms(self, floor_z: float) -> tuple[GeomCfg, ...]:
        """Returns its geoms in the world's frame; numbers are rounded, so that every libm gives the same."""
        cosine, sine = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        rot = (round(math.cos(self.yaw_rad / 2), 9), 0.0, 0.0, round(math.sin(self.yaw_rad / 2), 9))
        return tuple(
            replace(
                geom,
                pos=(
                    round(self.x + cosine * geom.pos[0] - sine * geom.pos[1], 9),
                    round(self.y + sine * geom.pos[0] + cosine * geom.pos[1], 9),
                    floor_z + geom.pos[2],
                ),
                rot=rot,
                rgba=(*shade(geom.rgba[:3], self.placement.tint), 1.0),
            )
            for geom in self.item.geoms
        )

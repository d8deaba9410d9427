"""Stand, hook frame and wrench of robosuite's ToolHang (``models/objects/composite*``, MIT).

The frame's pointed tip is ten blocks instead of 51; softness of contacts is MuJoCo's own.
"""

import math
from dataclasses import dataclass

from envs.scenario import GeomCfg, LinkCfg, ObjectCfg, Quat, Rgba, Vec3

STAND_HALF_M: Vec3 = (0.06, 0.07, 0.08)
BASE_M = 0.01
"""Thickness of the stand's base."""

BASE_POS: Vec3 = (0.0, 0.0, BASE_M / 2 - STAND_HALF_M[2])
SOCKET_M = (0.0, 0.045)
"""Middle of the socket in the stand's x and y."""

SOCKET_FLOOR_M, SOCKET_TOP_M = BASE_M - STAND_HALF_M[2], STAND_HALF_M[2]
"""Heights of both ends of the socket in the stand's frame."""

_OUTER_M, _WALL_M = 0.012, 0.001
WALLS: tuple[Vec3, ...] = tuple(
    (SOCKET_M[0] + x * (_OUTER_M - _WALL_M) / 2, SOCKET_M[1] + y * (_OUTER_M - _WALL_M) / 2, BASE_M / 2)
    for x, y in ((0.0, -1.0), (-1.0, 0.0), (0.0, 1.0), (1.0, 0.0))
)
"""Middles of the socket's walls, round about."""

FRAME_M, ROD_M, THICK_M, PRONG_M = 0.095, 0.18, 0.0075, 0.012
"""Length of the bar, of the rod with it, thickness of both, and height of the prong at the bar's end."""

ROD_X_M, BAR_Z_M = (FRAME_M - THICK_M) / 2, (ROD_M - THICK_M) / 2
GRIP_HALF_M: Vec3 = (0.0127, 0.0127, 0.03175)
GRIP_POS: Vec3 = (ROD_X_M, 0.0, 0.0525)
_TIP_HALF_M, _TIP_RADIUS_M, _POINT_M, _POINT_RADIUS_M = 0.0127, 0.00325, 0.01905, 0.001

MOUNT: Vec3 = (ROD_X_M, 0.0, -ROD_M / 2)
CORNER: Vec3 = (ROD_X_M, 0.0, BAR_Z_M)
HOOK_END: Vec3 = (-FRAME_M / 2, 0.0, BAR_Z_M)
TIP: Vec3 = (ROD_X_M, 0.0, -ROD_M / 2 - 2 * _TIP_HALF_M - _POINT_M)
PRONG: Vec3 = (-ROD_X_M, 0.0, ROD_M / 2)
"""Points of the frame: lower and upper end of the rod, end of the bar, tip, and foot of the prong."""

HANDLE_HALF_M: Vec3 = (0.0825, 0.00875, 0.0016)
TOOL_GRIP_HALF_M: Vec3 = (0.04, 0.015, 0.015)
RING_HALF_M = 0.0035
_SIDES = 8

_BRASS: Rgba = (0.72, 0.58, 0.3, 1.0)
_STEEL: Rgba = (0.55, 0.56, 0.6, 1.0)
_BLACK: Rgba = (0.13, 0.13, 0.13, 1.0)
_GREEN: Rgba = (0.0, 1.0, 0.0, 0.5)
_STICKY: Vec3 = (0.95, 0.3, 0.1)


@dataclass(frozen=True, kw_only=True, slots=True)
class Ring:
    """A ring at an end of the wrench: eight blocks.

    Attributes:
        outer_m: Outer radius.
        inner_m: Inner radius.
        side: -1 for the end at negative x, 1 for the other.
    """

    outer_m: float
    inner_m: float
    side: float

    @property
    def block_m(self) -> float:
        """Half the thickness of a block, along the radius."""
        return (self.outer_m - self.inner_m) * math.cos(math.pi / _SIDES) / 2

    @property
    def middle_m(self) -> float:
        """The ring's middle on the wrench's x axis."""
        return self.side * (HANDLE_HALF_M[0] + self.outer_m - 2 * self.block_m)

    @property
    def radius_m(self) -> float:
        """Distance of the blocks' middles from the ring's."""
        return self.inner_m * math.cos(math.pi / _SIDES) + self.block_m

    def geoms(self, middle_m: float) -> tuple[GeomCfg, ...]:
        """Returns its blocks about a point of the x axis, the first at its end of negative x."""
        half = (self.block_m, self.outer_m * math.sin(math.pi / _SIDES), RING_HALF_M)
        blocks = []
        for index in range(_SIDES):
            angle = math.pi - index * 2 * math.pi / _SIDES
            x, y = self.radius_m * math.cos(angle), self.radius_m * math.sin(angle)
            rot: Quat = (math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2))
            blocks.append(
                GeomCfg.box(half, (middle_m + x, y, 0.0), _STEEL, 2000.0, rot=rot, friction=_STICKY)
            )
        return tuple(blocks)


RING = Ring(outer_m=0.0175, inner_m=0.0105, side=-1.0)
"""The larger ring, which is hung up."""

OTHER_RING = Ring(outer_m=0.015, inner_m=0.01, side=1.0)
RING_POS: Vec3 = (RING.middle_m, 0.0, 0.0)
RING_ENDS: tuple[Vec3, Vec3] = (
    (RING.middle_m - RING.radius_m, 0.0, 0.0),
    (RING.middle_m + RING.radius_m, 0.0, 0.0),
)
"""Middles of the ring's outer and inner block."""


def stand() -> ObjectCfg:
    """Returns the stand; its origin is at half its height."""
    quarter: Quat = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
    wall = (_WALL_M / 2, _OUTER_M / 2, STAND_HALF_M[2] - BASE_M / 2)
    geoms = [GeomCfg.box((STAND_HALF_M[0], STAND_HALF_M[1], BASE_M / 2), BASE_POS, _BRASS, 50000.0)]
    for index, place in enumerate(WALLS):
        rot = (1.0, 0.0, 0.0, 0.0) if index % 2 else quarter
        geoms.append(GeomCfg.box(wall, place, _BRASS, 50000.0, rot=rot))
    hole = 0.35 * (_OUTER_M - _WALL_M)
    rim = (*SOCKET_M, SOCKET_TOP_M - _WALL_M / 2)
    geoms.append(GeomCfg.box((hole, hole, _WALL_M / 2), rim, _GREEN, 0.0, collides=False))
    return ObjectCfg(name="stand", geoms=tuple(geoms), pos=(0.0, 0.0, STAND_HALF_M[2]))


def frame() -> ObjectCfg:
    """Returns the frame: a rod with a grip and a pointed tip, and a bar with a prong at its end."""
    half, dense = THICK_M / 2, 500.0
    tip_z, point_z = -ROD_M / 2 - _TIP_HALF_M, -ROD_M / 2 - 2 * _TIP_HALF_M
    tip = GeomCfg(
        shape="cylinder",
        size=(_TIP_RADIUS_M, _TIP_HALF_M),
        pos=(ROD_X_M, 0.0, tip_z),
        rgba=_STEEL,
        mass_kg=2 * math.pi * _TIP_RADIUS_M**2 * _TIP_HALF_M * dense,
    )
    geoms = [
        GeomCfg.box((half, half, (ROD_M - THICK_M) / 2), (ROD_X_M, 0.0, -half), _BRASS, dense),
        GeomCfg.box(GRIP_HALF_M, GRIP_POS, _BLACK, dense),
        tip,
    ]
    count = 10
    for index in range(count):
        share = (index + 0.5) / count
        wide = _TIP_RADIUS_M + share * (_POINT_RADIUS_M - _TIP_RADIUS_M)
        place = (ROD_X_M, 0.0, point_z - share * _POINT_M)
        geoms.append(GeomCfg.box((wide, wide, _POINT_M / count / 2), place, _STEEL, dense))
    bar = GeomCfg.box((FRAME_M / 2, half, half), (0.0, 0.0, BAR_Z_M), _BRASS, dense)
    prong = GeomCfg.box((half, half, PRONG_M / 2), (PRONG[0], 0.0, (ROD_M + PRONG_M) / 2), _BRASS, dense)
    return ObjectCfg(
        name="frame",
        geoms=(*geoms, prong),
        links=(LinkCfg(name="bar", geoms=(bar,)),),
        pos=(0.0, 0.0, -TIP[2]),
        feels=("tool/ring",),
    )


def tool(robot: str) -> ObjectCfg:
    """Returns the wrench: a handle with a grip along x, and a ring at either end.

    Args:
        robot: The robot whose touch it feels.
    """
    handle = GeomCfg.box(HANDLE_HALF_M, (0.0, 0.0, 0.0), _STEEL, 2000.0, friction=_STICKY)
    grip = GeomCfg.box(TOOL_GRIP_HALF_M, (0.0, 0.0, 0.0), _BLACK, 2000.0)
    return ObjectCfg(
        name="tool",
        geoms=(handle, grip, *OTHER_RING.geoms(OTHER_RING.middle_m)),
        links=(LinkCfg(name="ring", geoms=RING.geoms(0.0), pos=RING_POS),),
        pos=(0.0, 0.0, TOOL_GRIP_HALF_M[2]),
        feels=(robot, "frame/bar"),
    )

"""CALVIN's play tables, built from primitives (``mees/calvin_env``, ``data/calvin_table_A`` to ``D``, MIT).

Dimensions are those of the meshes, joints those of the URDFs; the four tables have the same parts at other
places. CALVIN shows the table at 0.8 of that size
(``conf/scene/calvin_scene_A.yaml``: ``global_scaling``); numbers here are before scaling, and every
function scales what it returns. Frames are the URDF's: x to the right, y to the back, z up, the origin
between the feet; a link's frame is that of its joint.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from envs.rotations import from_euler, rotate
from envs.scenario import GeomCfg, LinkCfg, ObjectJointCfg, Quat, Rgba, Vec3

SCALE = 0.8
DESK_HEIGHT_M = 0.55 * SCALE
"""Height of the desk above the table's feet."""

SLIDE_TRAVEL_M, DRAWER_TRAVEL_M, SWITCH_TRAVEL_M = 0.35 * SCALE, 0.275 * SCALE, 0.11 * SCALE


@dataclass(frozen=True, slots=True)
class TableLayout:
    """Where the parts of a table are along x, in its URDF's units.

    Attributes:
        slide: Left edge of the closed sliding door.
        travel: How far the door slides to the left.
        opening: Ends of the cabinet's opening, which the door covers in part.
        drawer: Middle of the drawer.
        button: Middle of the button.
        led: Middle of the LED.
        switch: Middle of the switch.
        bulb: Middle of the light bulb.
    """

    slide: float = -0.125
    travel: float = 0.35
    opening: tuple[float, float] = (-0.45, 0.2)
    drawer: float = 0.125
    button: float = -0.35
    led: float = -0.35
    switch: float = 0.375
    bulb: float = 0.375


LAYOUTS = {
    "A": TableLayout(),
    "B": TableLayout(0.11, 0.38, (-0.225, 0.425), 0.225, 0.35, 0.35, -0.4, -0.4),
    "C": TableLayout(0.075, 0.3, (-0.225, 0.425), 0.125, -0.15, -0.15, -0.4, -0.4),
    "D": TableLayout(drawer=0.225, button=-0.15, led=-0.15),
}

SLIDE_POS = (-0.125, 0.09375, 0.66908)
SLOPE_RAD = math.pi / 3
"""Rotation about x of parts on the cabinet's front: y points up the slope, z out of it."""

HANDLE = (0.175, 0.0, 0.0875)
"""Middle of the bar of the sliding door's handle, in the door's frame."""

_DARK: Rgba = (0.36, 0.24, 0.17, 1.0)
_WOOD: Rgba = (0.62, 0.46, 0.31, 1.0)
_GREY: Rgba = (0.62, 0.62, 0.64, 1.0)
_BLACK: Rgba = (0.08, 0.08, 0.09, 1.0)

Span = tuple[Vec3, Vec3]
"""Least and largest corner of a box."""

_DESK: tuple[Span, ...] = (
    ((-0.55, -0.225, 0.5), (0.55, 0.225, 0.55)),
    *(((x, y, 0.0), (x + 0.05, y + 0.04, 0.5)) for x in (-0.55, 0.5) for y in (-0.225, 0.185)),
)
_PLANK: Span = ((-0.325, 0.025, 0.525), (0.325, 0.2, 0.55))
"""Floor of the cabinet; x from the middle of its opening."""

_DOOR: tuple[Span, ...] = (((0.0, -0.1375, 0.0), (0.35, 0.1375, 0.025)),)
_DOOR_HANDLE: tuple[Span, ...] = (
    ((0.15, -0.1, 0.075), (0.2, 0.1, 0.1)),
    ((0.15, -0.1, 0.025), (0.2, -0.075, 0.075)),
    ((0.15, 0.075, 0.025), (0.2, 0.1, 0.075)),
)
_DRAWER: tuple[Span, ...] = (
    ((-0.275, -0.025, 0.2), (0.275, 0.1, 0.225)),
    ((-0.25, 0.0, -0.0475), (0.25, 0.025, 0.2)),
    ((-0.25, 0.0, -0.075), (0.25, 0.1, -0.0475)),
    ((-0.25, 0.025, -0.0475), (-0.22, 0.1, 0.2)),
    ((0.22, 0.025, -0.0475), (0.25, 0.1, 0.2)),
)
_DRAWER_HANDLE: tuple[Span, ...] = (
    ((-0.15, 0.025, 0.3), (0.15, 0.075, 0.325)),
    ((-0.15, 0.025, 0.225), (-0.12, 0.075, 0.3)),
    ((0.12, 0.025, 0.225), (0.15, 0.075, 0.3)),
)
_SWITCH: tuple[Span, ...] = (
    ((-0.075, 0.055, -0.03), (0.075, 0.08, 0.01)),
    ((-0.075, 0.0, -0.03), (-0.05, 0.055, 0.01)),
    ((0.05, 0.0, -0.03), (0.075, 0.055, 0.01)),
)


def scaled(point: Sequence[float]) -> Vec3:
    """Returns a point of the URDF at CALVIN's scale, m."""
    x, y, z = (SCALE * value for value in point)
    return (x, y, z)


def about_x(angle_rad: float) -> Quat:
    """Returns the orientation of a frame that is turned about x."""
    w, x, y, z = from_euler(np.array([0.0, 0.0, angle_rad])).tolist()
    return (w, x, y, z)


def box_table(layout: TableLayout = LAYOUTS["A"]) -> tuple[tuple[GeomCfg, ...], tuple[LinkCfg, ...]]:
    """Returns the geoms that do not move; and door, drawer, button and switch, in this order."""
    return _base_geoms(layout), _links(layout)


def table_parts(layout: TableLayout) -> tuple[LinkCfg, ...]:
    """Returns a table as links: what does not move, the cabinet's floor, then as in :func:`box_table`.

    The lights are no part of it.
    """
    low, high = _DESK[0]
    left, right = layout.opening
    plank = _plank(layout)
    desk = (  # all but the cabinet's floor
        (low, (high[0], plank[0][1], high[2])),
        ((low[0], plank[0][1], low[2]), (left, high[1], high[2])),
        ((right, plank[0][1], low[2]), high),
        ((left, plank[1][1], low[2]), (right, high[1], high[2])),
        ((left, plank[0][1], low[2]), (right, plank[1][1], plank[0][2])),
    )
    geoms = (*_boxes((*desk, *_DESK[1:]), _WOOD), *_on_desk(layout)[:-2])
    base = LinkCfg(name="base", geoms=geoms)
    return base, LinkCfg(name="plank", geoms=_boxes((plank,), _WOOD)), *_links(layout)


def lit_lights(layout: TableLayout) -> tuple[GeomCfg, GeomCfg]:
    """Returns LED and light bulb as they are when they are lit."""
    led, bulb = _on_desk(layout)[-2:]
    return replace(led, rgba=(0.1, 1.0, 0.1, 1.0)), replace(bulb, rgba=(1.0, 1.0, 0.1, 1.0))


def dark_lights(layout: TableLayout) -> tuple[GeomCfg, ...]:
    """Returns LED and light bulb as they are when they are not lit."""
    return _on_desk(layout)[-2:]


def _plank(layout: TableLayout) -> Span:
    middle = sum(layout.opening) / 2
    (left, front, bottom), (right, back, top) = _PLANK
    return (middle + left, front, bottom), (middle + right, back, top)


def _base_geoms(layout: TableLayout) -> tuple[GeomCfg, ...]:
    """Returns the desk, the housing of its drawer, and the cabinet behind it, which do not move."""
    return (*_boxes(_DESK, _WOOD), *_on_desk(layout))


def _housing(drawer: float) -> tuple[Span, ...]:
    left, right = drawer - 0.25, drawer + 0.25
    return (
        ((-0.525, -0.2, 0.375), (0.525, 0.2, 0.4)),
        ((-0.525, -0.2, 0.4), (left, 0.2, 0.5)),
        ((right, -0.2, 0.4), (0.525, 0.2, 0.5)),
        ((left, 0.075, 0.4), (right, 0.2, 0.5)),
    )


def _on_desk(layout: TableLayout) -> tuple[GeomCfg, ...]:
    """Returns the drawer's housing, the cabinet, the button's rim, and at last LED and bulb."""
    left, right = layout.opening
    cabinet = (
        ((left, 0.2, 0.55), (right, 0.225, 0.7848)),
        ((-0.55, 0.175, 0.7848), (0.55, 0.225, 0.8098)),
    )
    led = [round(layout.led + offset, 6) for offset in (-0.1, 0.1)]
    slopes, steps = [], []
    for start, end in ((-0.55, left), (right, 0.55)):  # where a slope closes the cabinet
        slopes.append(((start, -0.15, -0.03), (end, 0.15, 0.0)))
        steps += [_behind_slope(start, end, step) for step in range(5)]
    slope = {"origin": (0.0, 0.1, 0.6799), "rot": about_x(SLOPE_RAD)}
    rails = [round(layout.switch + offset, 6) for offset in (-0.075, 0.05)]
    return (
        *_boxes(_housing(layout.drawer), _DARK),
        *_boxes((*cabinet, *steps), _DARK),
        *_boxes(slopes, _DARK, **slope),
        *_boxes([((x, -0.08, -0.001), (x + 0.025, 0.07, 0.001)) for x in rails], _BLACK, **slope),
        _disc((layout.button, -0.15, 0.5625), 0.05, 0.0125, _GREY),
        *_boxes([((led[0], 0.175, 0.8098), (led[1], 0.225, 0.8298))], (0.1, 0.35, 0.12, 1.0)),
        GeomCfg(
            shape="sphere",
            size=(0.035 * SCALE,),
            pos=scaled((layout.bulb, 0.2, 0.835)),
            rgba=(0.85, 0.8, 0.4, 1.0),
        ),
    )


def _behind_slope(left: float, right: float, step: int, num_steps: int = 5) -> Span:
    """Returns one of the boxes that fill the wedge behind a slope, so that it is solid from the side."""
    height = (0.8098 - 0.55) / num_steps
    top = 0.55 + (step + 1) * height
    front = 0.025 + (top - 0.55) / math.tan(SLOPE_RAD) + 0.004
    return ((left, front, top - height), (right, 0.225, top))


def _links(layout: TableLayout) -> tuple[LinkCfg, ...]:
    """Returns the sliding door, the drawer, the button and the switch, in this order."""
    parts = {
        "base__slide": (*_boxes(_DOOR, _WOOD, 1.2), *_boxes(_DOOR_HANDLE, _GREY, 0.34)),
        "base__drawer": (*_boxes(_DRAWER, _WOOD, 3.8), *_boxes(_DRAWER_HANDLE, _GREY, 0.43)),
        "base__button": (_disc((0.0, 0.015, 0.0), 0.04, 0.015, _BLACK, mass_kg=0.154, along_y=True),),
        "base__switch": _boxes(_SWITCH, _GREY, 0.239),
    }
    return tuple(link(name, geoms, layout) for name, geoms in parts.items())


def link(name: str, geoms: tuple[GeomCfg, ...], layout: TableLayout = LAYOUTS["A"]) -> LinkCfg:
    """Returns a moving part of the table: its frame and its joint are the URDF's.

    The URDF's joints have no friction. Theirs here is chosen, so that the parts stay where they are
    left; a spring lifts the button.
    """
    (_, y, z), turn, joint = _JOINTS[name]
    x = getattr(layout, name.removeprefix("base__"))
    pos = (x, y, z)
    if name == "base__slide":
        joint = replace(joint, range=(0.0, layout.travel * SCALE))
    return LinkCfg(name=name, geoms=geoms, joint=joint, pos=scaled(pos), rot=about_x(turn))


_JOINTS: dict[str, tuple[Vec3, float, ObjectJointCfg]] = {
    "base__slide": (
        SLIDE_POS,
        SLOPE_RAD,
        ObjectJointCfg(
            kind="slide", axis=(-1.0, 0.0, 0.0), range=(0.0, SLIDE_TRAVEL_M), damping=5.0, frictionloss=1.0
        ),
    ),
    "base__drawer": (
        (0.125, 0.0, 0.4),
        math.pi / 2,
        ObjectJointCfg(
            kind="slide", axis=(0.0, 0.0, 1.0), range=(0.0, DRAWER_TRAVEL_M), damping=5.0, frictionloss=1.0
        ),
    ),
    "base__button": (
        (-0.35, -0.15, 0.575),
        math.pi / 2,
        ObjectJointCfg(
            kind="slide",
            axis=(0.0, -1.0, 0.0),
            range=(0.0, 0.025 * SCALE),
            damping=2.0,
            stiffness=200.0,
            springref=-0.02,
        ),
    ),
    "base__switch": (
        (0.375, 0.07616, 0.61861),
        math.radians(150.0),
        ObjectJointCfg(
            kind="slide", axis=(0.0, 0.0, -1.0), range=(0.0, SWITCH_TRAVEL_M), damping=2.0, frictionloss=4.0
        ),
    ),
}


def _boxes(
    spans: Sequence[Span],
    rgba: Rgba,
    mass_kg: float = 0.0,
    *,
    origin: Vec3 = (0.0, 0.0, 0.0),
    rot: Quat = (1.0, 0.0, 0.0, 0.0),
) -> tuple[GeomCfg, ...]:
    """Returns boxes, given by their corners in a frame; they share ``mass_kg`` by their volumes."""
    low, high = np.array(spans).transpose(1, 0, 2)
    shares = (high - low).prod(-1) / (high - low).prod(-1).sum()
    middles = np.array(origin) + rotate(np.array(rot), (low + high) / 2)
    return tuple(
        GeomCfg(
            shape="box",
            size=scaled(half),
            pos=scaled(middle),
            rot=rot,
            rgba=rgba,
            mass_kg=float(mass_kg * share),
        )
        for half, middle, share in zip((high - low) / 2, middles, shares, strict=True)
    )


def _disc(
    pos: Vec3, radius: float, half_height: float, rgba: Rgba, mass_kg: float = 0.0, along_y: bool = False
) -> GeomCfg:
    return GeomCfg(
        shape="cylinder",
        size=(SCALE * radius, SCALE * half_height),
        pos=scaled(pos),
        rot=about_x(math.pi / 2 if along_y else 0.0),
        rgba=rgba,
        mass_kg=mass_kg,
    )

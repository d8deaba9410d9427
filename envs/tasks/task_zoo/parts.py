"""Things of the robosuite task zoo: pot, cabinet with a drawer, stove, lever switch, serving region, blocks.

Sizes and masses are those of ``models/*``; frames too, but for heights, which are above the table's top.
"""

import math
from typing import ClassVar

from envs.scenario import (
    CameraCfg,
    GeomCfg,
    LinkCfg,
    ObjectCfg,
    ObjectJointCfg,
    Quat,
    Rgba,
    RobotCfg,
    TableCfg,
    Vec3,
)
from envs.tasks.robosuite.scene import RobosuiteTask, panda

TABLE_HEIGHT_M = 0.9
"""``table_offset``."""

TABLE_X_M = -0.2
"""Middle of the table, from which places are drawn."""

INSET_M = 0.025
"""What is fixed to the table is placed from the table's middle, half its thickness below its top."""

METAL: Rgba = (0.62, 0.63, 0.66, 1.0)
STEEL: Rgba = (0.42, 0.44, 0.48, 1.0)
DARK: Rgba = (0.12, 0.12, 0.13, 1.0)
RED_WOOD: Rgba = (0.5, 0.16, 0.1, 1.0)
CERAMIC: Rgba = (0.9, 0.88, 0.84, 1.0)
BREAD: Rgba = (0.8, 0.58, 0.3, 1.0)
FLAME: Rgba = (0.95, 0.15, 0.05, 1.0)

_ALONG_X: Quat = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
_ALONG_Y: Quat = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)

POT_HALF_M = (0.057, 0.067)
"""Half of the pot's outer width and length."""

POT_INNER_M = (0.043, 0.053)
POT_BOTTOM_M = 0.0025
"""Height of the pot's origin above what it stands on."""

POT_HANDLE_M: Vec3 = (0.0, 0.06, 0.077)
"""Middle of a handle in the pot's frame; the other one is opposite."""

_SLIPPERY = (0.005, 0.005, 0.0001)

DRAWER_FLOOR_M = 0.044
"""Height of the drawer's floor in the cabinet's frame, above its lower face: 0.076 - 0.04 + 0.008."""

DRAWER_BAR_M: Vec3 = (0.0, -0.17, 0.116)
"""Middle of the bar of the drawer's handle in the cabinet's frame, when the drawer is shut."""

SHUT_M = -0.01
"""The drawer counts as shut beyond."""

LEVER_M = 0.05
"""Height of the middle of the lever's pad above its hinge."""

HINGE_M: Vec3 = (0.0, 0.0, 0.03)
"""The hinge in the switch's frame."""

LEVER_RAD = 0.3
STOVE_TOP_M = 0.0225
"""Height of the plate that carries a pot in the stove's frame."""


class ZooTask(RobosuiteTask):
    """A task of the zoo's table.

    The zoo's table ends behind the robot's pedestal; here it ends before it.
    """

    own_robot: ClassVar[RobotCfg] = panda(-0.56, table_height_m=TABLE_HEIGHT_M)
    table: ClassVar[TableCfg] = TableCfg(
        pos=(-0.125, 0.0, 0.0), half_size=(0.325, 0.4), height_m=TABLE_HEIGHT_M
    )
    camera: ClassVar[CameraCfg] = CameraCfg(
        name="front", pos=(1.1, 0.0, 0.85), look_at=(-0.1, 0.0, 0.05), fovy_deg=34.0
    )


def box(half: Vec3, pos: Vec3, rgba: Rgba, mass_kg: float = 0.0, friction: Vec3 | None = None) -> GeomCfg:
    """Returns a box; its friction is MuJoCo's default unless given."""
    return GeomCfg(
        shape="box", size=half, pos=pos, rgba=rgba, mass_kg=mass_kg, friction=friction or (1.0, 0.005, 0.0001)
    )


def block(name: str, half: Vec3, rgba: Rgba, feels: tuple[str, ...] = ()) -> ObjectCfg:
    """Returns a block of 500 kg/m³."""
    geom = box(half, (0.0, 0.0, 0.0), rgba, 8.0 * math.prod(half) * 500.0)
    return ObjectCfg(name=name, geoms=(geom,), pos=(0.0, 0.0, half[2]), feels=feels)


def pot() -> ObjectCfg:
    """Returns the pot with a handle over each of its two shorter walls (``pot_object.py``)."""
    (x, y), wall, tall = POT_INNER_M, 0.007, 0.035
    boxes: list[tuple[Vec3, Vec3]] = [((x, y, 0.005), (0.0, 0.0, 0.0025))]
    boxes += [((0.057, wall, tall), (0.0, sign * 0.06, tall - POT_BOTTOM_M)) for sign in (-1.0, 1.0)]
    boxes += [((wall, y, tall), (sign * 0.05, 0.0, tall - POT_BOTTOM_M)) for sign in (-1.0, 1.0)]
    boxes += [((0.0275, wall, 0.01), (0.0, sign * POT_HANDLE_M[1], POT_HANDLE_M[2])) for sign in (-1.0, 1.0)]
    geoms = tuple(box(half, pos, STEEL, 8.0 * math.prod(half) * 1000.0, _SLIPPERY) for half, pos in boxes)
    return ObjectCfg(name="pot", geoms=geoms, pos=(0.0, 0.0, POT_BOTTOM_M))


def cabinet(travel_m: float, rgba: Rgba, floor_m: float = -0.04) -> ObjectCfg:
    """Returns the cabinet, whose drawer opens along negative y of its frame.

    Its file gives the drawer a range of 4 cm that its compiler does not apply; what stops it are the posts
    behind its front, at which ``travel_m`` ends.

    Args:
        travel_m: Travel of the drawer.
        rgba: Colour.
        floor_m: Height of the middle of the drawer's floor in the drawer's frame.
    """
    walls: list[tuple[Vec3, Vec3]] = [
        ((0.008, 0.112, 0.064), (-0.11, 0.0, 0.065)),
        ((0.008, 0.112, 0.064), (0.11, 0.0, 0.065)),
        ((0.102, 0.008, 0.064), (0.0, 0.092, 0.062)),
        ((0.102, 0.102, 0.014), (0.0, -0.008, 0.004)),
        ((0.102, 0.102, 0.008), (0.0, 0.01, 0.121)),
        ((0.012, 0.012, 0.064), (-0.102, -0.1, 0.065)),
        ((0.012, 0.012, 0.064), (0.102, -0.1, 0.065)),
    ]
    drawer: list[tuple[Vec3, Vec3, float]] = [
        ((0.088, 0.010, 0.046), (0.0, -0.095, 0.007), 0.04),
        ((0.095, 0.008, 0.028), (0.0, 0.065, 0.008), 0.04),
        ((0.008, 0.084, 0.028), (-0.072, 0.0, 0.0), 0.04),
        ((0.008, 0.084, 0.028), (0.072, 0.0, 0.0), 0.04),
        ((0.08, 0.09, 0.008), (0.0, 0.0, floor_m), 7.6),  # the file gives the whole 7.85 kg
    ]
    handle = [
        GeomCfg(shape="capsule", size=(0.009, half), pos=(x, y, 0.04), rot=rot, rgba=CERAMIC, mass_kg=0.06)
        for half, x, y, rot in (
            (0.03, -0.05, -0.13, _ALONG_Y),
            (0.05, 0.0, -0.16, _ALONG_X),
            (0.03, 0.05, -0.13, _ALONG_Y),
        )
    ]
    slide = ObjectJointCfg(kind="slide", axis=(0.0, 1.0, 0.0), range=(-travel_m, 0.0), damping=100.0)
    link = LinkCfg(
        name="drawer",
        geoms=(*(box(half, pos, rgba, mass) for half, pos, mass in drawer), *handle),
        joint=slide,
        pos=(0.0, -0.01, 0.076),
    )
    geoms = tuple(box(half, pos, rgba) for half, pos in walls)
    return ObjectCfg(name="cabinet", geoms=geoms, links=(link,), kind="fixed")


def stove() -> ObjectCfg:
    """Returns the stove; the zoo's burner is a mesh that touches nothing, ours two rings."""
    rings = tuple(
        GeomCfg(
            shape="cylinder",
            size=(radius, 2e-4),
            pos=(0.0, 0.0, STOVE_TOP_M + 3e-4 * level),
            rgba=rgba,
            collides=False,
        )
        for level, (radius, rgba) in enumerate(((0.07, DARK), (0.055, STEEL), (0.035, DARK)), 1)
    )
    plates = (
        box((0.095, 0.095, 0.02), (0.0, 0.0, 0.0), METAL),
        box((0.095, 0.095, 0.0005), (0.0, 0.0, 0.022), METAL),
    )
    return ObjectCfg(name="stove", geoms=(*plates, *rings), kind="fixed")


def flame() -> ObjectCfg:
    """Returns the red disc that lies on a burner which is on."""
    disc = GeomCfg(shape="cylinder", size=(0.0625, 3e-4), rgba=FLAME)
    return ObjectCfg(name="flame", geoms=(disc,), kind="marker")


def button() -> ObjectCfg:
    """Returns the lever switch: it leans to positive y where its joint is negative."""
    base = GeomCfg(shape="cylinder", size=(0.04, 0.02), rgba=METAL)
    lever = (
        box((0.025, 0.007, 0.025), (0.0, 0.0, 0.05), METAL, 0.12),
        GeomCfg(
            shape="cylinder",
            size=(0.0325, 0.0125),
            pos=(0.0, 0.0, HINGE_M[2] + LEVER_M),
            rot=_ALONG_Y,
            rgba=METAL,
            mass_kg=0.12,
        ),
    )
    joint = ObjectJointCfg(
        kind="hinge",
        axis=(1.0, 0.0, 0.0),
        pos=HINGE_M,
        range=(-LEVER_RAD, LEVER_RAD),
        damping=0.1,
        frictionloss=0.1,
    )
    return ObjectCfg(
        name="button", geoms=(base,), links=(LinkCfg(name="switch", geoms=lever, joint=joint),), kind="fixed"
    )


def serving_region() -> ObjectCfg:
    """Returns the red plate that marks where food is served."""
    plate = GeomCfg(shape="box", size=(0.07, 0.10, 5e-4), rgba=RED_WOOD)
    return ObjectCfg(name="region", geoms=(plate,), kind="marker")

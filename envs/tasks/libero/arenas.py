"""LIBERO's five arenas: which file, where the workspace, the robot and the camera are.

Poses are those of LIBERO's problems (``libero/envs/problems/*.py``, code MIT): ``workspace`` is
``workspace_offset``, ``fixture_z_m`` is ``z_offset``; cameras are their ``_setup_camera``; bases are the
``base_xpos_offset`` of its two Pandas, raised by robosuite's mount.
"""

import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path

from envs.core.errors import unknown_name
from envs.mjcf.imported import imported
from envs.scenario.units import Quat, Vec3
from envs.tasks.libero.files import asset

MOUNT_TOP_M = 0.912
"""Height of a mounted Panda's base: robosuite's ``RethinkMount`` above the ground."""

TABLE_HALF_M = (0.5, 0.6, 0.025)
"""Half sizes of the tables of kitchen and table arena: ``table_full_size`` is (1, 1.2, 0.05)."""

MAX_FACES = 8000
"""Triangles that an arena's furniture shares."""

IMAGE_SIZE = 768
"""Pixels along a side of the image of each of them."""

_DOWN: Quat = (0.6380177736, 0.3048497438, 0.3048498631, 0.6380177736)
_LOW: Quat = (0.6182166934, 0.3432307541, 0.3432314396, 0.6182177067)


@dataclass(frozen=True, slots=True)
class Arena:
    """One arena.

    Attributes:
        file: Its MJCF file, below ``scenes``.
        workspace: What regions are measured from, m.
        top_z_m: Height on which things stand.
        fixture_z_m: Height of the bottom of a fixture over the workspace.
        base: Position of the robot's base, m.
        mounted: Whether the robot stands on a mount.
        camera_pos: Position of the camera ``agentview``, m.
        camera_rot: Its orientation, wxyz, in MuJoCo's convention.
        floor: Image of the floor.
        wall: Image of the walls.
        has_table: Whether the file's table takes the size of :data:`TABLE_HALF_M`.
        table_friction: Friction coefficients of that table.
    """

    file: str
    workspace: Vec3
    top_z_m: float
    fixture_z_m: float
    base: Vec3
    mounted: bool
    camera_pos: Vec3
    camera_rot: Quat
    floor: str
    wall: str
    has_table: bool = False
    table_friction: Vec3 = (1.0, 0.005, 0.0001)


_KITCHEN = Arena(
    "libero_kitchen_tabletop_base_style.xml",
    workspace=(0.0, 0.0, 0.90),
    top_z_m=0.90,
    fixture_z_m=-0.04,
    base=(-0.66, 0.0, MOUNT_TOP_M),
    mounted=True,
    camera_pos=(0.6586131746834771, 0.0, 1.6103500240372423),
    camera_rot=_DOWN,
    floor="gray_ceramic_tile.png",
    wall="yellow_linen_wall_texture.png",
    has_table=True,
)

ARENAS = {
    "kitchen": _KITCHEN,
    "table": replace(
        _KITCHEN,
        file="libero_tabletop_base_style.xml",
        floor="light-gray-floor-tile.png",
        wall="light-gray-plaster.png",
        table_friction=(0.6, 0.005, 0.0001),
    ),
    "study": Arena(
        "libero_study_base_style.xml",
        workspace=(-0.2, 0.0, 0.867),
        top_z_m=0.885,
        fixture_z_m=-0.04,
        base=(-0.75, 0.0, MOUNT_TOP_M),
        mounted=True,
        camera_pos=(0.4586131746834771, 0.0, 1.6103500240372423),
        camera_rot=_DOWN,
        floor="light-gray-floor-tile.png",
        wall="light-gray-plaster.png",
    ),
    "living_room": Arena(
        "libero_living_room_tabletop_base_style.xml",
        workspace=(0.0, 0.0, 0.41),
        top_z_m=0.437,
        fixture_z_m=-0.014,
        base=(-0.51, 0.0, 0.42),
        mounted=False,
        camera_pos=(0.6065773716836134, 0.0, 0.96),
        camera_rot=_LOW,
        floor="seamless_wood_planks_floor.png",
        wall="light-gray-plaster.png",
    ),
    "floor": Arena(
        "libero_floor_base_style.xml",
        workspace=(0.0, 0.0, -0.035),
        top_z_m=0.0,
        fixture_z_m=-0.025,
        base=(-0.6, 0.0, 0.0),
        mounted=False,
        camera_pos=(0.8965773716836134, 5.216182733499864e-07, 0.65),
        camera_rot=_LOW,
        floor="light-gray-floor-tile.png",
        wall="light-gray-plaster.png",
    ),
}

_OF_PROBLEM = {
    "libero_kitchen_tabletop_manipulation": "kitchen",
    "libero_tabletop_manipulation": "table",
    "libero_study_tabletop_manipulation": "study",
    "libero_living_room_tabletop_manipulation": "living_room",
    "libero_floor_manipulation": "floor",
}

SURFACE_FIXTURES = ("main_table", "kitchen_table", "study_table", "living_room_table", "floor")
"""Fixtures of task files that are part of the arena."""


def arena_of(problem: str) -> Arena:
    """Returns the arena of a problem's name.

    Raises:
        UnknownNameError: There is none.
    """
    if problem.lower() not in _OF_PROBLEM:
        raise unknown_name("problem", problem, _OF_PROBLEM)
    return ARENAS[_OF_PROBLEM[problem.lower()]]


def arena_file(arena: Arena) -> Path:
    """Returns the arena's furniture, table, floor and walls as one object's file."""

    def edit(tree: ET.Element) -> None:
        _as_one_body(tree)
        for name, image in (("texplane", arena.floor), ("tex-wall", arena.wall)):
            for texture in tree.iterfind(f"asset/texture[@name='{name}']"):
                texture.set("file", f"../textures/{image}")
        if arena.has_table:
            _size_table(tree, arena)

    return imported(asset(f"scenes/{arena.file}"), max_faces=MAX_FACES, image_size=IMAGE_SIZE, edit=edit)


def _as_one_body(tree: ET.Element) -> None:
    world = tree.find("worldbody")
    assert world is not None, "an arena has a world"
    items = [item for item in world if item.tag in ("geom", "body")]
    for item in list(world):
        world.remove(item)
    whole = ET.SubElement(world, "body", name="object")
    whole.extend(items)
    for geom in whole.iter("geom"):
        if geom.get("type") == "plane":  # the scene's own ground is what things touch
            geom.set("contype", "0")
            geom.set("conaffinity", "0")
    for texture in tree.iterfind("asset/texture"):  # planks, so that the table's top shows them once
        if texture.get("name", "").startswith("tex-table"):
            texture.set("type", "2d")


def _size_table(tree: ET.Element, arena: Arena) -> None:
    """Does what LIBERO's arenas do with the table's body, and puts the legs into its corners."""
    body = next(item for item in tree.iter("body") if item.get("name") == "table")
    x, y, z = arena.workspace
    half = TABLE_HALF_M
    body.set("pos", _text(x, y, z - half[2]))
    leg = (z - 2 * half[2]) / 2
    corners = iter([(sx * (half[0] - 0.1), sy * (half[1] - 0.1)) for sx in (1, -1) for sy in (1, -1)])
    for geom in body.iter("geom"):
        if geom.get("type") == "cylinder":
            geom.set("pos", _text(*next(corners), -half[2] - leg))
            geom.set("size", _text(0.025, leg))
            continue
        geom.set("size", _text(*half))
        if geom.get("group") == "0":
            geom.set("friction", _text(*arena.table_friction))


def _text(*values: float) -> str:
    return " ".join(f"{value:.6g}" for value in values)

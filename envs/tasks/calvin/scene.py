"""CALVIN's scenes A to D as ours: table, blocks, robot, cameras (``conf/scene``, ``conf/cameras``, MIT).

The frame is CALVIN's: the table's feet stand at the origin of the floor, the desk is at 0.44 m. Shapes that
collide are boxes of the meshes' dimensions (:mod:`envs.tasks.calvin_table`); with ``looks=meshes`` CALVIN's
own meshes are rendered in their place.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

from envs.core.assets import asset_folder
from envs.robots.franka import FRANKA
from envs.scenario import (
    GROUND,
    CameraCfg,
    GeomCfg,
    LinkCfg,
    ObjectCfg,
    PhysicsCfg,
    Rgba,
    RobotCfg,
    ScenarioCfg,
    Vec3,
)
from envs.tasks.calvin.catalogue import BLOCKS
from envs.tasks.calvin_table import LAYOUTS, SCALE, TableLayout, dark_lights, lit_lights, table_parts
from envs.tasks.tabletop import TABLETOP_LOOKS, wrist_camera

Looks = Literal["boxes", "meshes"]

TABLE = "play_table"

PARTS = ("base", "plank", "slide", "drawer", "button", "switch")
"""What a block feels of the table."""

SLIDE, DRAWER, BUTTON, SWITCH = range(4)
"""Columns of the table's joints."""

HOME = (-1.21779124, 1.03987629, 2.11978254, -2.34205014, -0.87015899, 1.64119093, 0.55344928, 0.04, 0.04)
"""Joints at the start of CALVIN's evaluation (``get_env_state_for_initial_condition``), rad and m."""

BASE_POS_M = (-0.34, -0.46, 0.24)

DESK_M = 0.44
"""Height of the desk, and of the cabinet's floor."""

HALF_WIDTH_M = 0.025 * SCALE
"""Half width and half height of every block."""

HALF_LENGTHS_M = {"small": 0.025 * SCALE, "middle": 0.035 * SCALE, "big": 0.05 * SCALE}

BLOCK_KG = 1.0
"""``data/blocks``."""

BLOCK_FRICTION = 0.7

SIZES = {
    "A": {"red": "middle", "blue": "big", "pink": "small"},
    "B": {"red": "small", "blue": "big", "pink": "middle"},
    "C": {"red": "big", "blue": "small", "pink": "middle"},
    "D": {"red": "middle", "blue": "small", "pink": "big"},
}

_COLOURS: dict[str, Rgba] = {
    "red": (0.8, 0.05, 0.05, 1.0),
    "blue": (0.05, 0.1, 0.8, 1.0),
    "pink": (0.85, 0.2, 0.75, 1.0),
}

HIDDEN_Z_M = -5.0
"""Where a light is that is not lit."""

LIT = ("led_lit", "bulb_lit")
"""Markers that shine where a light is lit."""

MARKS = (*(f"start_{colour}" for colour in BLOCKS), "start_joints", "start_touches", "start_led")
"""Markers that are not seen and carry how an episode began; see :mod:`envs.tasks.calvin.memory`."""

_UNSEEN = GeomCfg(shape="sphere", size=(0.001,), visible=False)

CONTROL_30_HZ = PhysicsCfg(timestep_s=1.0 / 480.0, decimation=16)

STATIC_CAMERA = CameraCfg(
    name="static",
    pos=(2.871459009488717, -2.166602199425597, 2.555159848480571),
    look_at=(-0.026242351159453392, -0.0302329882979393, 0.3920000493526459),
    up=(0.4041403970338857, 0.22629790978217404, 0.8862616969685161),
    fovy_deg=10.0,
    width=200,
    height=200,
)
"""``conf/cameras/cameras/static.yaml``."""


@dataclass(frozen=True, slots=True)
class Surface:
    """Ranges of x and y of a place where blocks lie, m."""

    x: tuple[float, float]
    y: tuple[float, float]


SURFACES = {
    "A": {
        "table": Surface((-0.2, 0.35), (-0.15, -0.03)),
        "slider_left": Surface((-0.32, -0.16), (0.05, 0.12)),
        "slider_right": Surface((-0.05, 0.13), (0.05, 0.12)),
    },
    "B": {
        "table": Surface((-0.35, 0.15), (-0.15, -0.03)),
        "slider_left": Surface((-0.12, 0.06), (0.05, 0.12)),
        "slider_right": Surface((0.15, 0.33), (0.05, 0.12)),
    },
    "C": {
        "table": Surface((0.0, 0.35), (-0.15, -0.03)),
        "slider_left": Surface((-0.12, 0.06), (0.05, 0.12)),
        "slider_right": Surface((0.15, 0.3), (0.05, 0.12)),
    },
    "D": {
        "table": Surface((0.0, 0.35), (-0.15, -0.03)),
        "slider_left": Surface((-0.32, -0.16), (0.05, 0.12)),
        "slider_right": Surface((-0.05, 0.13), (0.05, 0.12)),
    },
}
"""``surfaces`` of ``conf/scene/calvin_scene_*.yaml``."""

ROBOT = replace(FRANKA.with_home(HOME), pos=BASE_POS_M)


def gripper_camera(robot: RobotCfg) -> CameraCfg:
    """Returns the camera on the hand: 84 pixels, 75 degrees (``conf/cameras/cameras/gripper.yaml``)."""
    return replace(wrist_camera(robot), name="gripper", fovy_deg=75.0, width=84, height=84)


@lru_cache(maxsize=16)
def scenario_of(scene: str, robot: RobotCfg, looks: Looks, assets_dir: str | None) -> ScenarioCfg:
    """Returns a scene.

    Args:
        scene: ``A`` to ``D``.
        robot: The robot, at its place.
        looks: Which table is rendered.
        assets_dir: Where CALVIN's files are, for its meshes; see :func:`~envs.core.assets.asset_folder`.

    Raises:
        ConfigError: Its files are needed and absent.
    """
    layout = LAYOUTS[scene]
    links = table_parts(layout)
    if looks == "meshes":
        links = _with_meshes(links, asset_folder("calvin", assets_dir), scene, layout)
    table = ObjectCfg(name=TABLE, geoms=(*dark_lights(layout), _plinth(robot)), links=links, kind="fixed")
    lights = (
        ObjectCfg(name=name, geoms=(geom,), kind="marker", pos=(0.0, 0.0, HIDDEN_Z_M))
        for name, geom in zip(LIT, lit_lights(layout), strict=True)
    )
    marks = (ObjectCfg(name=name, kind="marker", geoms=(_UNSEEN,)) for name in MARKS)
    blocks = (_block(scene, colour, robot.name) for colour in BLOCKS)
    return ScenarioCfg(
        robots=(robot,),
        objects=(table, *blocks, *lights, *marks),
        cameras=(STATIC_CAMERA, gripper_camera(robot)),
        appearance=TABLETOP_LOOKS,
        table=None,
        physics=CONTROL_30_HZ,
    )


def half_length(scene: str, colour: str) -> float:
    """Returns half the length of a block, m."""
    return HALF_LENGTHS_M[SIZES[scene][colour]]


def felt_by(colour: str, robot: str) -> tuple[str, ...]:
    """Returns what a block feels: robot, other blocks, parts of the table, the ground."""
    others = tuple(f"block_{other}" for other in BLOCKS if other != colour)
    return (robot, *others, *(f"{TABLE}/{_body(part)}" for part in PARTS), GROUND)


def _body(part: str) -> str:
    return part if part in ("base", "plank") else f"base__{part}"


def _block(scene: str, colour: str, robot: str) -> ObjectCfg:
    half = half_length(scene, colour)
    geom = GeomCfg(
        shape="box",
        size=(half, HALF_WIDTH_M, HALF_WIDTH_M),
        mass_kg=BLOCK_KG,
        friction=(BLOCK_FRICTION, 0.005, 0.0001),
        rgba=_COLOURS[colour],
    )
    place: Vec3 = (0.1 * BLOCKS.index(colour), -0.1, DESK_M + HALF_WIDTH_M)
    return ObjectCfg(name=f"block_{colour}", geoms=(geom,), pos=place, feels=felt_by(colour, robot))


def _plinth(robot: RobotCfg) -> GeomCfg:
    """Returns what the robot stands on; CALVIN shows a cylinder of that radius."""
    height = robot.pos[2] / 2
    return GeomCfg(
        shape="cylinder", size=(0.13, height), pos=(*robot.pos[:2], height), rgba=(0.9, 0.9, 0.9, 1.0)
    )


def _with_meshes(
    links: tuple[LinkCfg, ...], folder: Path, scene: str, layout: TableLayout
) -> tuple[LinkCfg, ...]:
    """Returns the table's links with CALVIN's meshes as what is seen of them."""
    root = folder / "data" / f"calvin_table_{scene}"
    wood, handle = (
        str(root / "textures" / f"{name}.png") for name in ("dark_wood", "dark_wood__gray_handle")
    )
    images = {"base": wood, "base__slide": handle, "base__drawer": handle}
    dressed = []
    for link in links:
        kind = link.name.removeprefix("base__")
        suffix = "STL" if kind in ("button", "plank") else "obj"
        image = images.get(link.name)
        shown = link.geoms[0].rgba if image is None else (1.0, 1.0, 1.0, 1.0)
        if kind == "plank":  # its box is its mesh
            dressed.append(link)
            continue
        seen = GeomCfg(
            shape="mesh",
            size=(SCALE, SCALE, SCALE),
            mesh=str(root / "meshes" / f"{kind}_link.{suffix}"),
            texture=image,
            rgba=shown,
            collides=False,
        )
        dressed.append(replace(link, geoms=(*(replace(geom, visible=False) for geom in link.geoms), seen)))
    del layout
    return tuple(dressed)

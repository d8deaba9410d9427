"""A task's scene: LIBERO's arena, fixtures and objects, from the files of the extra ``libero``."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from envs.core.assets import resolve
from envs.core.errors import ConfigError, UnknownNameError
from envs.kinematics.object_parts import ObjectParts, parts_of
from envs.mjcf.imported import imported
from envs.robots.franka import FRANKA
from envs.rotations import from_yaw, rotate
from envs.scenario import Appearance, CameraCfg, LightCfg, ObjectCfg, Quat, RobotCfg, ScenarioCfg, Vec3
from envs.tasks.libero.arenas import SURFACE_FIXTURES, Arena, arena_file, arena_of
from envs.tasks.libero.bddl import Problem, read_problem
from envs.tasks.libero.catalogue import Entry
from envs.tasks.libero.files import asset, problem_file
from envs.tasks.tabletop import CONTROL_20_HZ

HOME = (0.0, -0.161037389, 0.0, -2.44459747, 0.0, 2.2267522, 0.7853981634, 0.020833, 0.020833)
"""``init_qpos`` of LIBERO's Pandas, and the fingers of robosuite's ``PandaGripper``."""

ARENA, MOUNT = "arena", "mount"

OBJECT_FACES, FIXTURE_FACES = 1500, 3000
"""Triangles of one object and of one fixture."""

IMAGE_SIZE = 256
"""Pixels along a side of the image of a simplified mesh: a millimetre of an object 10 cm wide has two."""

_FAMILIES = ("stable_hope_objects", "stable_scanned_objects", "turbosquid_objects", "articulated_objects")
ALWAYS_THERE = "scenes/libero_kitchen_tabletop_base_style.xml"
"""A file of the assets, by which their folder is found."""

_MOUNT_FILE = "robosuite:models/assets/bases/rethink_mount.xml"
PHYSICS = {"mujoco": {"cone": "elliptic", "impratio": 20.0}}
"""robosuite's (``models/assets/base.xml``)."""

LOOKS = Appearance(
    lights=(
        LightCfg(kind="distant", direction=(-0.2, -0.15, -1.0), intensity=0.7, cast_shadow=True),
        LightCfg(kind="distant", direction=(0.5, 0.4, -1.0), intensity=0.25),
    ),
)


@dataclass(frozen=True, slots=True, eq=False)
class LiberoScene:
    """What a task file becomes.

    Attributes:
        problem: The task file.
        arena: Its arena.
        scenario: The scene, with everything at rest where the file's regions have their middles.
        parts: Object or fixture to its parts, sites and collision boxes.
        categories: Object or fixture to its category.
    """

    problem: Problem
    arena: Arena
    scenario: ScenarioCfg
    parts: dict[str, ObjectParts]
    categories: dict[str, str]

    @property
    def robot(self) -> RobotCfg:
        """The robot."""
        return self.scenario.robots[0]

    @property
    def fixtures(self) -> tuple[str, ...]:
        """Fixtures that are objects of the scenario, in the file's order."""
        return tuple(name for name in self.problem.fixtures if name not in SURFACE_FIXTURES)


@lru_cache(maxsize=8)
def scene_of(entry: Entry) -> LiberoScene:
    """Builds the scene of a task.

    Raises:
        MissingExtraError: The extra ``libero`` is not installed.
        ConfigError: A file of it is damaged.
    """
    problem = read_problem(problem_file(entry))
    try:
        arena = arena_of(problem.name)
    except UnknownNameError as error:
        raise problem.error("problem", str(error).rstrip(".")) from error
    feels = _touches(problem)
    categories = problem.fixtures | problem.objects
    objects, parts = [_arena_object(arena)], {}
    if arena.mounted:
        objects.append(_mount(arena))
    for name, category in categories.items():
        if name in SURFACE_FIXTURES:
            continue
        free = name in problem.objects
        source = asset_of(category)
        if source is None:
            raise problem.error(name, f"the installed assets have no '{category}', which '{name}' is")
        faces = OBJECT_FACES if free else FIXTURE_FACES
        path = imported(source, max_faces=faces, image_size=IMAGE_SIZE, free=free)
        parts[name] = parts_of(path)
        pos, rot = _rest_pose(problem, arena, name, source)
        objects.append(
            ObjectCfg(
                name=name,
                mjcf=str(path),
                mjcf_root="object",
                mjcf_joints=tuple(joint.name for joint in parts[name].joints),
                mjcf_shown=(1,),
                pos=pos,
                rot=rot,
                kind="free" if free else "fixed",
                feels=feels.get(name, ()),
            )
        )
    scenario = ScenarioCfg(
        robots=(replace(FRANKA, pos=arena.base).with_home(HOME),),
        objects=tuple(objects),
        cameras=_cameras(arena),
        appearance=LOOKS,
        table=None,
        room=None,
        ground_half_size_m=3.0,
        physics=CONTROL_20_HZ,
        simulators=PHYSICS,
    )
    return LiberoScene(problem, arena, scenario, parts, categories)


def asset_of(category: str) -> Path | None:
    """Returns the MJCF file of a category of objects; None if the installed packages have no such category.

    Raises:
        MissingExtraError: A package of the extra is not installed.
    """
    assets = asset(ALWAYS_THERE).parents[1]
    for family in _FAMILIES:
        inside = "" if family == "articulated_objects" else f"{category}/"
        path = assets / family / f"{inside}{category}.xml"
        if path.is_file():
            return path
    return None


def _touches(problem: Problem) -> dict[str, tuple[str, ...]]:
    """Returns which contacts the goal asks for: object to what it has to touch."""
    feels: dict[str, tuple[str, ...]] = {}
    for atom in problem.goal:
        if atom.predicate != "on":
            continue
        thing, place = atom.args
        target = problem.regions[place].target if place in problem.regions else place
        if target not in SURFACE_FIXTURES:
            feels[thing] = tuple(dict.fromkeys((*feels.get(thing, ()), target)))
    return feels


def _arena_object(arena: Arena) -> ObjectCfg:
    return ObjectCfg(
        name=ARENA, mjcf=str(arena_file(arena)), mjcf_root="object", mjcf_shown=(1,), kind="fixed"
    )


def _mount(arena: Arena) -> ObjectCfg:
    """Returns robosuite's mount, for the eye alone: the arm does not reach below itself."""
    return ObjectCfg(
        name=MOUNT,
        mjcf=str(imported(resolve(_MOUNT_FILE), root="base", max_faces=OBJECT_FACES)),
        mjcf_root="base",
        mjcf_shown=(1,),
        kind="marker",
        pos=arena.base,
    )


def _rest_pose(problem: Problem, arena: Arena, name: str, source: Path) -> tuple[Vec3, Quat]:
    """Returns where a fixture is, or about where an object begins.

    A fixture's bottom is ``fixture_z_m`` over the workspace, which is what LIBERO's sampler does.
    """
    x, y, z = arena.workspace
    for atom in problem.init:
        region = problem.regions.get(atom.args[-1])
        if atom.predicate != "on" or atom.args[0] != name or region is None or region.ranges is None:
            continue
        middle = region.middle
        if name in problem.objects:
            return (x + middle[0], y + middle[1], arena.top_z_m + 0.1), (1.0, 0.0, 0.0, 0.0)
        yaw = 0.0 if region.yaw is None else sum(region.yaw) / 2
        w, qx, qy, qz = (float(value) for value in from_yaw(yaw))
        return (x + middle[0], y + middle[1], z + arena.fixture_z_m - _bottom(source)), (w, qx, qy, qz)
    if name in problem.fixtures:
        raise problem.error(
            name, f"the fixture '{name}' is put nowhere: '(:init …)' says of none that it is on"
        )
    return (x, y, arena.top_z_m + 0.3), (1.0, 0.0, 0.0, 0.0)


def _bottom(source: Path) -> float:
    """Returns the height of an object's ``bottom_site``, m."""
    for site in ET.parse(source).getroot().iter("site"):
        if site.get("name") == "bottom_site":
            return float(site.get("pos", "0 0 0").split()[2])
    raise ConfigError(f"{source} has no site 'bottom_site'.")


def _cameras(arena: Arena) -> tuple[CameraCfg, CameraCfg]:
    """Returns LIBERO's two cameras: 128 pixels there, as many as asked for here."""
    pos, rot = np.array(arena.camera_pos), np.array(arena.camera_rot)
    ahead, up = rotate(rot, np.array([0.0, 0.0, -1.0])), rotate(rot, np.array([0.0, 1.0, 0.0]))
    agent = CameraCfg(
        name="agentview",
        pos=arena.camera_pos,
        look_at=_triple(pos + ahead),
        up=_triple(up),
        fovy_deg=45.0,
        orbit_pos=(0.0, 0.0, arena.top_z_m),
    )
    hand = CameraCfg(
        name="robot0_eye_in_hand",
        mount=f"{FRANKA.name}/right_hand",
        pos=(0.05, 0.0, 0.0),
        look_at=(0.05, 0.0, 1.0),
        up=(1.0, 0.0, 0.0),
        fovy_deg=75.0,
    )
    return agent, hand


def _triple(values: np.ndarray) -> Vec3:
    x, y, z = (float(value) for value in values)
    return x, y, z

"""What a scene is made of, as frozen data: no simulator, no file access, no mutation.

Lengths are metres, masses kilograms, angles radians unless the name says ``_deg``, quaternions
``(w, x, y, z)``, colours linear RGB in [0, 1].
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from envs.errors import ConfigError

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]
IDENTITY: Quat = (1.0, 0.0, 0.0, 0.0)

SURFACES = ("table", "wall", "ground")
"""The surfaces whose material the environment channel may change."""


@dataclass(frozen=True, kw_only=True, slots=True)
class JointCfg:
    """One controlled joint: its name in the robot's file, its actuator and where it rests.

    Attributes:
        name: Joint name in the robot's MJCF.
        kp: Position gain, N·m/rad (N/m for a slide joint).
        kd: Damping gain, N·m·s/rad (N·s/m).
        force_limit: Largest actuator force, N·m (N).
        range: Position limits, rad (m).
        default: Rest position, rad (m).
        flip: The file's axis is turned round, so that the joint's positive direction is ours.
        damping: Passive damping that replaces the file's, or None to keep it.
        armature: Rotor inertia that replaces the file's, or None to keep it.
        frictionloss: Dry friction that replaces the file's, or None to keep it.
    """

    name: str
    kp: float
    kd: float
    force_limit: float
    range: tuple[float, float]
    default: float
    flip: bool = False
    damping: float | None = None
    armature: float | None = None
    frictionloss: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class RobotCfg:
    """A robot: one MJCF file, an optional gripper attached to it, and its joints in our order.

    Attributes:
        name: Prefix of everything the robot brings into the scene.
        mjcf: Asset reference, ``"package:path/inside/package.xml"``.
        root: Body of ``mjcf`` that is attached to the world.
        gripper_mjcf: Asset reference of the gripper, or None.
        gripper_root: Body of the gripper's file that is attached.
        gripper_mount: Body of the robot that carries the gripper.
        joints: Controlled joints; this order is the order of every array of joints.
        ee_site: Site that is called the end effector.
        gripper_joints: Names of the joints, of ``joints``, that open and close the gripper.
        pos: Base position in the world, m.
        rot: Base orientation in the world, wxyz.
        gravity_compensated: Gravity does not act on the robot's own links.
    """

    name: str
    mjcf: str
    root: str
    joints: tuple[JointCfg, ...]
    ee_site: str
    gripper_mjcf: str | None = None
    gripper_root: str | None = None
    gripper_mount: str | None = None
    gripper_joints: tuple[str, ...] = ()
    pos: Vec3 = (0.0, 0.0, 0.0)
    rot: Quat = IDENTITY
    gravity_compensated: bool = True

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the controlled joints, in order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def default_qpos(self) -> tuple[float, ...]:
        """Rest position of every joint, in order."""
        return tuple(joint.default for joint in self.joints)


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectCfg:
    """A rigid object made of one primitive.

    Attributes:
        name: Its name in the scene and in the state.
        shape: ``box`` (half sizes), ``sphere`` (radius), ``cylinder`` or ``capsule`` (radius, half length).
        size: Sizes of the shape, m.
        mass_kg: Mass.
        friction: Sliding, torsional and rolling friction coefficients.
        rgba: Colour and opacity.
        pos: Position at rest, m.
        rot: Orientation at rest, wxyz.
        kind: ``free`` moves under physics; ``fixed`` never moves; ``marker`` is only seen, and is
            placed once an episode.
    """

    name: str
    shape: Literal["box", "sphere", "cylinder", "capsule"]
    size: tuple[float, ...]
    mass_kg: float = 0.1
    friction: Vec3 = (1.0, 0.005, 0.0001)
    rgba: tuple[float, float, float, float] = (0.6, 0.6, 0.6, 1.0)
    pos: Vec3 = (0.0, 0.0, 0.0)
    rot: Quat = IDENTITY
    kind: Literal["free", "fixed", "marker"] = "free"

    def __post_init__(self) -> None:
        expected = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2}[self.shape]
        if len(self.size) != expected or min(self.size) <= 0:
            raise ConfigError(
                f"Object '{self.name}': a {self.shape} has {expected} positive sizes, given {self.size}."
            )


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraCfg:
    """A pinhole camera.

    Attributes:
        name: Its name; its picture is the observation ``observation.images.<name>``.
        pos: Position in the world, m.
        look_at: The point in the middle of the picture, m. World z points up in the picture.
        fovy_deg: Vertical field of view, degrees.
        width: Pixels.
        height: Pixels.
    """

    name: str
    pos: Vec3
    look_at: Vec3
    fovy_deg: float = 45.0
    width: int = 256
    height: int = 256


@dataclass(frozen=True, kw_only=True, slots=True)
class LightCfg:
    """A light.

    Attributes:
        kind: ``distant`` shines in parallel along ``direction``; ``area`` is a cylinder lamp at ``pos``.
        pos: Position, m (a distant light's is only where it is drawn from).
        direction: Where it shines to; need not be normalized.
        color: Linear RGB.
        intensity: Multiplies the colour.
        radius_m: Radius of the lamp.
        length_m: Length of the lamp, along world x.
        cast_shadow: Whether it casts shadows.
    """

    kind: Literal["distant", "area"] = "distant"
    pos: Vec3 = (0.0, 0.0, 4.0)
    direction: Vec3 = (0.0, 0.0, -1.0)
    color: Vec3 = (1.0, 1.0, 1.0)
    intensity: float = 1.0
    radius_m: float = 0.05
    length_m: float = 1.0
    cast_shadow: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class SurfaceMaterial:
    """How a surface looks.

    Attributes:
        texture: Name in the material library, or None for the plain colour.
        rgb: Multiplies the texture.
        size_m: Side of the square that one copy of the texture covers.
        roughness: 0 is a mirror, 1 is chalk.
        specular: Strength of highlights, 0 to 1.
        metallic: 0 is a dielectric, 1 a metal.
    """

    texture: str | None = None
    rgb: Vec3 = (1.0, 1.0, 1.0)
    size_m: float = 1.0
    roughness: float = 0.7
    specular: float = 0.3
    metallic: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class TableCfg:
    """A table whose top is the plane z = ``pos[2]``.

    Attributes:
        pos: Centre of the top, m.
        half_size: Half extents of the top in x and y, m.
        thickness_m: Thickness of the top.
        height_m: Height of the top above the ground.
    """

    pos: Vec3 = (0.0, 0.0, 0.0)
    half_size: tuple[float, float] = (1.0, 1.0)
    thickness_m: float = 0.05
    height_m: float = 0.75


@dataclass(frozen=True, kw_only=True, slots=True)
class RoomCfg:
    """Four walls round the scene; the ground lies below the table.

    Attributes:
        half_size_m: Distance of each wall from the origin.
        height_m: Height of the walls.
    """

    half_size_m: float = 3.0
    height_m: float = 4.0


@dataclass(frozen=True, kw_only=True, slots=True)
class PhysicsCfg:
    """Time steps and gravity.

    Attributes:
        timestep_s: One physics step.
        decimation: Physics steps per control step.
        gravity: Acceleration, m/s².
    """

    timestep_s: float = 0.005
    decimation: int = 10
    gravity: Vec3 = (0.0, 0.0, -9.81)

    @property
    def control_hz(self) -> float:
        """Control steps per second."""
        return 1.0 / (self.timestep_s * self.decimation)


@dataclass(frozen=True, kw_only=True, slots=True)
class Appearance:
    """Everything of a scene that changes its pictures and not its physics: one draw of a level.

    Attributes:
        materials: Surface (of :data:`SURFACES`) to material.
        cameras: Camera name to camera; replaces the scenario's of that name.
        lights: All lights.
        table_yaw_rad: Rotation of the table top about z.
        object_reflection: ``(roughness, specular, metallic)`` of every object and robot, or None for
            what the scenario says.
    """

    materials: Mapping[str, SurfaceMaterial] = field(default_factory=dict)
    cameras: Mapping[str, CameraCfg] = field(default_factory=dict)
    lights: tuple[LightCfg, ...] = ()
    table_yaw_rad: float = 0.0
    object_reflection: Vec3 | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class ScenarioCfg:
    """A scene: what is in it, how it looks by default, and how time passes.

    Attributes:
        robots: Robots.
        objects: Objects.
        cameras: Cameras.
        appearance: Default materials and lights (level 0).
        table: The table, or None.
        room: The walls, or None.
        physics: Physics.
        simulators: Simulator name to a block of settings that only it understands.
    """

    robots: tuple[RobotCfg, ...] = ()
    objects: tuple[ObjectCfg, ...] = ()
    cameras: tuple[CameraCfg, ...] = ()
    appearance: Appearance = field(default_factory=Appearance)
    table: TableCfg | None = field(default_factory=TableCfg)
    room: RoomCfg | None = field(default_factory=RoomCfg)
    physics: PhysicsCfg = field(default_factory=PhysicsCfg)
    simulators: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [item.name for item in (*self.robots, *self.objects)]
        double = sorted({name for name in names if names.count(name) > 1})
        if double:
            raise ConfigError(f"A scenario's names must be unique; used twice: {', '.join(double)}.")

    def object(self, name: str) -> ObjectCfg:
        """Returns the object called ``name``."""
        return next(item for item in self.objects if item.name == name)

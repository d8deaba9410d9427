"""Scene description as frozen data: no simulator, no file access, no mutation.

Lengths are metres, masses kilograms, angles radians unless the name says ``_deg``, quaternions
``(w, x, y, z)``, colours linear RGB in [0, 1].
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from envs.core.errors import ConfigError, unknown_name
from envs.core.ranges import check_ranges
from envs.scenario.appearance import SURFACES, Appearance, CameraCfg, LightCfg, SensorCfg, SurfaceMaterial
from envs.scenario.lighting import LightingCfg
from envs.scenario.objects import GeomCfg, LinkCfg, ObjectCfg, ObjectJointCfg
from envs.scenario.robots import BodyCfg, GripperCfg, JointCfg, ReadingCfg, RobotCfg, SiteCfg
from envs.scenario.units import IDENTITY, Quat, Rgba, Vec3

__all__ = [
    "GROUND",
    "IDENTITY",
    "SURFACES",
    "Appearance",
    "BodyCfg",
    "CameraCfg",
    "GeomCfg",
    "GripperCfg",
    "JointCfg",
    "LightCfg",
    "LightingCfg",
    "LinkCfg",
    "ObjectCfg",
    "ObjectJointCfg",
    "PhysicsCfg",
    "Quat",
    "ReadingCfg",
    "Rgba",
    "RobotCfg",
    "RoomCfg",
    "ScenarioCfg",
    "SensorCfg",
    "SiteCfg",
    "SurfaceMaterial",
    "TableCfg",
    "Vec3",
]


GROUND = "ground"
"""The ground, where a robot or an object says what it feels."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TableCfg:
    """A table whose top is the plane z = ``pos[2]``.

    Attributes:
        pos: Centre of the top, m.
        half_size: Half extents of the top in x and y, m.
        thickness_m: Thickness of the top.
        height_m: Height of the top above the ground.
        collides: Whether it collides; if not, something else of the scene carries objects.
        visible: Whether it is rendered.
    """

    pos: Vec3 = (0.0, 0.0, 0.0)
    half_size: tuple[float, float] = (1.0, 1.0)
    thickness_m: float = 0.05
    height_m: float = 0.75
    collides: bool = True
    visible: bool = True

    def __post_init__(self) -> None:
        check_ranges(self, "TableCfg.", above_0=("thickness_m", "height_m"), unit=" m")
        if not min(self.half_size) > 0:
            raise ConfigError(f"TableCfg.half_size is two lengths above 0 m, given {self.half_size}.")


@dataclass(frozen=True, kw_only=True, slots=True)
class RoomCfg:
    """Four walls round the scene; the ground is below the table.

    Attributes:
        half_size_m: Distance of each wall from the origin.
        height_m: Height of the walls.
    """

    half_size_m: float = 3.0
    height_m: float = 4.0

    def __post_init__(self) -> None:
        check_ranges(self, "RoomCfg.", above_0=("half_size_m", "height_m"), unit=" m")


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

    def __post_init__(self) -> None:
        check_ranges(self, "PhysicsCfg.", above_0=("timestep_s",), unit=" s")
        if self.decimation < 1:
            raise ConfigError(
                f"PhysicsCfg.decimation, physics steps per control step, must be at least 1, given "
                f"{self.decimation}."
            )

    @property
    def control_hz(self) -> float:
        """Control steps per second."""
        return 1.0 / (self.timestep_s * self.decimation)

    def divided(self, decimation: int) -> "PhysicsCfg":
        """Returns the physics of the same control steps with another number of physics steps in each.

        Raises:
            ConfigError: if that number is below 1.
        """
        if decimation < 1:
            raise ConfigError(f"A control step needs at least 1 physics step, given {decimation}.")
        longer = self.timestep_s * self.decimation / decimation
        return replace(self, timestep_s=longer, decimation=decimation)


@dataclass(frozen=True, kw_only=True, slots=True)
class ScenarioCfg:
    """A scene: its contents, default appearance and physics.

    Attributes:
        robots: Robots.
        objects: Objects.
        cameras: Cameras.
        appearance: Default materials and lights (level 0).
        lighting: Ranges of the lighting channel (level 3).
        table: The table, or None.
        room: The walls, or None.
        ground_half_size_m: Half the visible ground's size where there is no room.
        physics: Physics.
        simulators: Simulator name to a block of settings that only it understands.
    """

    robots: tuple[RobotCfg, ...] = ()
    objects: tuple[ObjectCfg, ...] = ()
    cameras: tuple[CameraCfg, ...] = ()
    appearance: Appearance = field(default_factory=Appearance)
    lighting: LightingCfg = field(default_factory=LightingCfg)
    table: TableCfg | None = field(default_factory=TableCfg)
    room: RoomCfg | None = field(default_factory=RoomCfg)
    ground_half_size_m: float = 5.0
    physics: PhysicsCfg = field(default_factory=PhysicsCfg)
    simulators: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [item.name for item in (*self.robots, *self.objects)]
        double = sorted({name for name in names if names.count(name) > 1})
        if double:
            raise ConfigError(f"A scenario's names must be unique; used twice: {', '.join(double)}.")
        parts = [f"{item.name}/{link.name}" for item in self.objects for link in item.links]
        for item in (*self.robots, *self.objects):
            for other in item.feels:
                if other not in (*names, *parts, GROUND):
                    raise unknown_name(f"thing that '{item.name}' feels", other, (*names, *parts, GROUND))
        check_ranges(self, "ScenarioCfg.", above_0=("ground_half_size_m",), unit=" m")

    @property
    def floor_z(self) -> float:
        """Height of the ground, m: below the table, or 0."""
        return 0.0 if self.table is None else self.table.pos[2] - self.table.height_m

    def seen_by(self, cameras: Sequence[str] | None = None, image_size: int | None = None) -> "ScenarioCfg":
        """Returns this scene with some of its cameras.

        Args:
            cameras: Names of the cameras, in the order of the observation; none or None is the first.
            image_size: Pixels along the shorter side of their images, whose aspect is each camera's own;
                None is each camera's own size.

        Raises:
            UnknownNameError: if there is no camera of a name.
        """
        known = {camera.name: camera for camera in self.cameras}
        for name in cameras or ():
            if name not in known:
                raise unknown_name("camera", name, known)
        chosen = [known[name] for name in cameras] if cameras else list(self.cameras[:1])
        if image_size is not None:
            chosen = [camera.resized(image_size) for camera in chosen]
        return replace(self, cameras=tuple(chosen))

    def tuned(self, simulator: str, settings: Mapping[str, Any]) -> "ScenarioCfg":
        """Returns this scene with some of one simulator's settings replaced; the simulator checks them."""
        block = {**self.simulators.get(simulator, {}), **settings}
        return replace(self, simulators={**self.simulators, simulator: block})

    def object(self, name: str) -> ObjectCfg:
        """Returns the object called ``name``."""
        return next(item for item in self.objects if item.name == name)

"""Visual properties of a scene, without effect on physics: cameras, lights and materials."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from envs.core.errors import ConfigError
from envs.core.ranges import check_ranges
from envs.scenario.objects import GeomCfg
from envs.scenario.units import MaterialName, Vec3

SURFACES = ("table", "wall", "ground")
"""The surfaces whose material the environment channel may change."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraCfg:
    """A pinhole camera.

    Attributes:
        name: Its name; its image is the observation ``observation.images.<name>``.
        pos: Position in the frame of ``mount``, m.
        look_at: The point in the middle of the image, in the same frame, m.
        fovy_deg: Vertical field of view, degrees.
        width: Pixels.
        height: Pixels.
        mount: Body that carries it, such as ``"franka/gripper/eef"``; None is the world.
        turns: Whether it rotates with ``mount``. If not it only translates with it, at its offset in world
            axes when the scene is at rest.
        up: Direction that points up in the image, in the same frame.
        orbit_pos: Middle of the sphere on which the camera channel places it, m.
        orbit_radius_m: Radius of that sphere.
        orbit_yaw_rad: Where azimuth 0 of that sphere is, about world z from +x: where the robot faces.
    """

    name: str
    pos: Vec3
    look_at: Vec3
    fovy_deg: float = 45.0
    width: int = 256
    height: int = 256
    mount: str | None = None
    turns: bool = True
    up: Vec3 = (0.0, 0.0, 1.0)
    orbit_pos: Vec3 = (0.0, 0.0, 0.0)
    orbit_radius_m: float = 1.5
    orbit_yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        if not 0 < self.fovy_deg < 180:
            raise ConfigError(
                f"CameraCfg.fovy_deg is an angle above 0 and below 180 degrees, given {self.fovy_deg}."
            )
        check_ranges(self, "CameraCfg.", above_0=("orbit_radius_m",), unit=" m")
        if not any(self.up):
            raise ConfigError(f"CameraCfg.up is a direction, given {self.up}.")
        if min(self.width, self.height) < 1:
            raise ConfigError(f"An image has pixels; given width {self.width} and height {self.height}.")
        if tuple(self.pos) == tuple(self.look_at):
            raise ConfigError(f"Camera '{self.name}' is where it looks at: pos=look_at={self.pos}.")

    def resized(self, shorter: int) -> "CameraCfg":
        """Returns this camera with an image of the same aspect.

        Args:
            shorter: Pixels along the shorter side; the longer one has an even number, which videos need.
        """
        own = min(self.width, self.height)
        width, height = (
            shorter if side == own else 2 * round(shorter * side / own / 2)
            for side in (self.width, self.height)
        )
        return replace(self, width=width, height=height)


@dataclass(frozen=True, kw_only=True, slots=True)
class LightCfg:
    """A light.

    Attributes:
        kind: ``distant`` shines in parallel along ``direction``; ``area`` is a cylinder lamp at ``pos``.
        pos: Position, m (of a distant light: of its shadow camera only).
        direction: Direction of its rays; need not be normalized.
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

    def __post_init__(self) -> None:
        check_ranges(self, "LightCfg.", from_0=("intensity", "radius_m", "length_m"))
        if not any(self.direction):
            raise ConfigError(f"LightCfg.direction is a direction, given {self.direction}.")


@dataclass(frozen=True, kw_only=True, slots=True)
class SurfaceMaterial:
    """Material of a surface.

    Attributes:
        texture: Name in the material library, or None for the plain colour.
        rgb: Multiplies the texture.
        size_m: Side of the square that one copy of the texture covers.
        roughness: 0 is a mirror, 1 is chalk.
        specular: Strength of highlights, 0 to 1.
        metallic: 0 is a dielectric, 1 a metal.
    """

    texture: MaterialName | None = None
    rgb: Vec3 = (1.0, 1.0, 1.0)
    size_m: float = 1.0
    roughness: float = 0.7
    specular: float = 0.3
    metallic: float = 0.0

    def __post_init__(self) -> None:
        for name in ("roughness", "specular", "metallic"):
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigError(f"SurfaceMaterial.{name} is within 0 to 1, given {getattr(self, name)}.")
        check_ranges(self, "SurfaceMaterial.", above_0=("size_m",), unit=" m")


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorCfg:
    """What cameras do to their images after these are rendered; the defaults change nothing.

    Lengths are shares of an image's height, so that images of all sizes are blurred alike; noise is a share
    of the range of a pixel, 255. See :mod:`envs.randomization.disturbances` for the order and the formulas.

    Attributes:
        exposure_ev: Exposure, in stops: each doubles the light.
        gamma: Exponent of the values after exposure: above 1 is darker.
        blur_sigma: Standard deviation of a Gaussian blur.
        motion_length: Length of a straight blur, by motion.
        motion_angle_rad: Its direction, from the image's +x towards its bottom.
        gaussian_noise: Standard deviation of noise that is the same in dark and bright parts.
        shot_noise: Standard deviation, at white, of noise that grows with the root of the brightness.
        jpeg_quality: JPEG's quality, 1 to 100, or 0 for no compression.
        noise_seed: Seeds the noise; with the frame and the camera it decides it.
    """

    exposure_ev: float = 0.0
    gamma: float = 1.0
    blur_sigma: float = 0.0
    motion_length: float = 0.0
    motion_angle_rad: float = 0.0
    gaussian_noise: float = 0.0
    shot_noise: float = 0.0
    jpeg_quality: int = 0
    noise_seed: int = 0

    def __post_init__(self) -> None:
        check_ranges(self, "SensorCfg.", above_0=("gamma",), from_0=("noise_seed",))
        for name in ("blur_sigma", "motion_length", "gaussian_noise", "shot_noise"):
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigError(f"SensorCfg.{name} is a share, 0 to 1, given {getattr(self, name)}.")
        if not 0 <= self.jpeg_quality <= 100:
            raise ConfigError(
                f"SensorCfg.jpeg_quality is 1 to 100, or 0 for no compression; given {self.jpeg_quality}."
            )

    @property
    def disturbs(self) -> bool:
        """Whether it changes an image at all."""
        return replace(self, noise_seed=0) != SensorCfg()


@dataclass(frozen=True, kw_only=True, slots=True)
class Appearance:
    """Visual properties of a scene, without effect on physics: one sample of a level.

    Attributes:
        materials: Surface (of :data:`SURFACES`) to material.
        cameras: Camera name to camera; replaces the scenario's of that name.
        lights: All lights.
        table_yaw_rad: Rotation of the table top about z.
        object_reflection: ``(roughness, specular, metallic)`` of every object and robot, or None for
            what the scenario says.
        furniture: Place of the room to its furniture's geoms, in the world's frame; visual only.
            See :mod:`envs.scenario.places` for the places, and how many geoms each can have.
        sensor: What cameras do to their images.
    """

    materials: Mapping[str, SurfaceMaterial] = field(default_factory=dict)
    cameras: Mapping[str, CameraCfg] = field(default_factory=dict)
    lights: tuple[LightCfg, ...] = ()
    table_yaw_rad: float = 0.0
    object_reflection: Vec3 | None = None
    furniture: Mapping[str, tuple[GeomCfg, ...]] = field(default_factory=dict)
    sensor: SensorCfg = SensorCfg()

    def __post_init__(self) -> None:
        if not all(0 <= value <= 1 for value in self.object_reflection or ()):
            raise ConfigError(
                "Appearance.object_reflection is (roughness, specular, metallic), each within 0 to 1, given "
                f"{self.object_reflection}."
            )

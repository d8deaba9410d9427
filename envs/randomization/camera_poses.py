"""The 59 camera poses: most face the robot, some look from the side.

The grid is RoboVerse's (``camera_pos_candidates.txt``, snapshot of 2025-06-21): azimuth θ from world +x,
towards which the robot faces, and polar angle φ from world +z, on a sphere of 1.5 m about the origin; a
camera may have another sphere.
"""

import math
from dataclasses import dataclass, replace

from envs.core.errors import unknown_name
from envs.scenario import CameraCfg, Vec3

RADIUS_M = 1.5

_GRID: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...] = (
    # azimuths, polar angles; degrees
    ((0, 8, -8), (50, 55, 58, 60, 62, 65, 70)),
    ((16, -16, 28, -28), (55, 58, 60, 62, 65)),
    ((40, -40, 60, -60), (58, 60, 62)),
    ((80, -80, 100, -100, 120, -120), (60,)),
)


@dataclass(frozen=True, slots=True)
class CameraPose:
    """A place on the sphere.

    Attributes:
        azimuth_deg: θ, from world +x towards +y.
        polar_deg: φ, from world +z.
    """

    azimuth_deg: int
    polar_deg: int

    @property
    def name(self) -> str:
        """The pose's name in the split files, such as ``"az-016-pol58"``."""
        return f"az{self.azimuth_deg:+04d}-pol{self.polar_deg:02d}"

    @property
    def pos(self) -> Vec3:
        """Position in the world, m; rounded, so that every machine's libm gives the same number."""
        theta, phi = math.radians(self.azimuth_deg), math.radians(self.polar_deg)
        return (
            round(RADIUS_M * math.sin(phi) * math.cos(theta), 9),
            round(RADIUS_M * math.sin(phi) * math.sin(theta), 9),
            round(RADIUS_M * math.cos(phi), 9),
        )


CAMERA_POSES = {
    pose.name: pose
    for azimuths, polars in _GRID
    for pose in (CameraPose(azimuth, polar) for azimuth in azimuths for polar in polars)
}
"""Name to pose, 59 of them."""


def place_camera(base: CameraCfg, pose: str) -> CameraCfg:
    """Moves a camera to a pose round its orbit's middle; name, target, field of view and size stay.

    Raises:
        UnknownNameError: if there is no pose of that name.
    """
    if pose not in CAMERA_POSES:
        raise unknown_name("camera pose", pose, CAMERA_POSES)
    scale = base.orbit_radius_m / RADIUS_M
    x, y, z = (scale * value for value in CAMERA_POSES[pose].pos)
    cosine, sine = math.cos(base.orbit_yaw_rad), math.sin(base.orbit_yaw_rad)
    middle = base.orbit_pos
    return replace(
        base, pos=(middle[0] + cosine * x - sine * y, middle[1] + sine * x + cosine * y, middle[2] + z)
    )

"""Configuration of ``roboverse convert``."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class ConvertConfig:
    """``roboverse convert``: a robot's MJCF as URDF or USD, or its URDF as MJCF.

    Attributes:
        robot: Registered robot, file, or asset such as robosuite:models/assets/robots/ur5e/robot.xml.
        to: Format: urdf, usd (needs usd-core), or mjcf for a robot whose file is URDF.
        root: Body of the file that is the robot, where the file holds several; empty for all of it.
        simplify: Merge and simplify the visual meshes of a registered robot.
        packages: Folder of the ROS packages that a URDF file names (package://); empty looks in the folders
            above the file.
        out: Folder to write to; empty for the cache, whose folder is named after the content.
    """

    robot: str = "franka"
    to: str = "urdf"
    root: str = ""
    simplify: bool = False
    packages: str = ""
    out: str = ""

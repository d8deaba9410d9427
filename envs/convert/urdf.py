"""Writes URDF (http://wiki.ros.org/urdf/XML) with extensions that its readers support.

``<mujoco>`` makes MuJoCo keep every link and mesh. ``drake:rotor_inertia`` of a transmission's actuator holds
the armature, which URDF lacks.
"""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from envs.convert.description import Description, Joint, Link, Shape
from envs.convert.obj import mesh_files
from envs.core.errors import ConfigError
from envs.mjcf.link_tree import Inertia
from envs.rotations import to_matrix

UNLIMITED = 1e4
"""Force, speed and (of a sliding joint without a range) position where the source sets no limit: the format
requires a number."""

_KINDS = {"fixed": "fixed", "hinge": "revolute", "slide": "prismatic"}
_DRAKE = "http://drake.mit.edu"


def write_urdf(description: Description, folder: Path) -> Path:
    """Writes ``<name>.urdf`` and, under ``meshes/``, its visual and collision meshes.

    Args:
        description: The robot.
        folder: Where to; it exists.

    Returns:
        The file.

    Raises:
        ConfigError: if a joint is a ball joint, which URDF does not have.
    """
    for joint in description.joints:
        if joint.kind == "ball":
            raise ConfigError(
                f"URDF has no ball joint, and '{description.name}' has one ('{joint.name}'). Three hinges "
                "would move otherwise: write to=usd, which has it."
            )
    (folder / "meshes").mkdir()
    files = mesh_files(
        folder / "meshes",
        [
            (shape.mesh, shape.material if role == "visual" else None)
            for shape, role in description.shapes()
            if shape.mesh is not None
        ],
    )
    root = ET.Element("robot", {"name": description.name, "xmlns:drake": _DRAKE})
    for loss in description.losses:
        root.append(ET.Comment(f" {loss.replace('--', '—')} "))
    extension = ET.SubElement(root, "mujoco")
    keep = {"fusestatic": "false", "discardvisual": "false", "strippath": "false", "balanceinertia": "false"}
    ET.SubElement(extension, "compiler", keep)
    for link in description.links:
        _add_link(root, link, files)
    for link in description.links:
        if link.parent is not None:
            _add_joint(root, link)
    for link in description.links:
        if link.joint.armature:
            _add_transmission(root, link.joint)
    ET.indent(root)
    path = folder / f"{description.name}.urdf"
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return path


def _add_link(root: ET.Element, link: Link, files: dict[tuple[int, int], str]) -> None:
    element = ET.SubElement(root, "link", {"name": link.name})
    _add_inertial(element, link.inertial)
    for shape in link.visuals:
        for part in _parts(shape):
            _add_shape(ET.SubElement(element, "visual"), part, files, seen=True)
    for shape in link.collisions:
        for part in _parts(shape):
            _add_shape(ET.SubElement(element, "collision"), part, files, seen=False)


def _add_inertial(link: ET.Element, inertial: Inertia) -> None:
    element = ET.SubElement(link, "inertial")
    _add_origin(element, inertial.com, inertial.rot)
    ET.SubElement(element, "mass", {"value": _number(inertial.mass)})
    xx, yy, zz = (_number(moment) for moment in inertial.moments)
    # Principal moments in a rotated frame: readers would diagonalize a full matrix, less exactly.
    ET.SubElement(element, "inertia", {"ixx": xx, "ixy": "0", "ixz": "0", "iyy": yy, "iyz": "0", "izz": zz})


def _parts(shape: Shape) -> list[Shape]:
    """Writes a capsule, which URDF lacks, as a cylinder and two spheres."""
    if shape.kind != "capsule":
        return [shape]
    radius, half = shape.size
    along = to_matrix(shape.rot)[:, 2] * half
    ends = [
        Shape("sphere", (radius,), shape.pos + sign * along, shape.rot, shape.material, None, shape.friction)
        for sign in (-1.0, 1.0)
    ]
    tube = Shape("cylinder", shape.size, shape.pos, shape.rot, shape.material, None, shape.friction)
    return [tube, *ends]


def _add_shape(element: ET.Element, shape: Shape, files: dict[tuple[int, int], str], *, seen: bool) -> None:
    _add_origin(element, shape.pos, shape.rot)
    geometry = ET.SubElement(element, "geometry")
    if shape.kind == "mesh":
        key = (id(shape.mesh), id(shape.material) if seen else id(None))
        ET.SubElement(geometry, "mesh", {"filename": f"meshes/{files[key]}", "scale": "1 1 1"})
    elif shape.kind == "box":
        ET.SubElement(geometry, "box", {"size": _numbers(2.0 * np.array(shape.size))})
    elif shape.kind == "sphere":
        ET.SubElement(geometry, "sphere", {"radius": _number(shape.size[0])})
    else:
        radius, half = shape.size
        ET.SubElement(geometry, "cylinder", {"radius": _number(radius), "length": _number(2.0 * half)})
    if seen:
        material = ET.SubElement(element, "material", {"name": shape.material.name})
        ET.SubElement(material, "color", {"rgba": " ".join(f"{v:g}" for v in shape.material.rgba)})


def _add_joint(root: ET.Element, link: Link) -> None:
    joint = link.joint
    kind = _KINDS[joint.kind]
    if joint.kind == "hinge" and joint.range is None:
        kind = "continuous"
    element = ET.SubElement(root, "joint", {"name": joint.name, "type": kind})
    _add_origin(element, link.pos, link.rot)
    ET.SubElement(element, "parent", {"link": str(link.parent)})
    ET.SubElement(element, "child", {"link": link.name})
    if joint.kind == "fixed":
        return
    ET.SubElement(element, "axis", {"xyz": _numbers(joint.axis)})
    limits: dict[str, str] = {}
    if joint.range is not None:
        limits = {"lower": _number(joint.range[0]), "upper": _number(joint.range[1])}
    if joint.kind == "slide" and joint.range is None:
        limits = {"lower": _number(-UNLIMITED), "upper": _number(UNLIMITED)}
    force = UNLIMITED if joint.max_force is None else joint.max_force
    ET.SubElement(element, "limit", {**limits, "effort": _number(force), "velocity": _number(UNLIMITED)})
    ET.SubElement(
        element, "dynamics", {"damping": _number(joint.damping), "friction": _number(joint.friction)}
    )
    if joint.mimic is not None:
        ET.SubElement(
            element,
            "mimic",
            {
                "joint": joint.mimic.joint,
                "multiplier": _number(joint.mimic.multiplier),
                "offset": _number(joint.mimic.offset),
            },
        )


def _add_transmission(root: ET.Element, joint: Joint) -> None:
    """The armature: reflected inertia is the rotor's times the gear ratio squared, which is 1 here."""
    element = ET.SubElement(root, "transmission", {"name": f"{joint.name}_transmission"})
    ET.SubElement(element, "type").text = "transmission_interface/SimpleTransmission"
    interface = "hardware_interface/EffortJointInterface"
    ET.SubElement(ET.SubElement(element, "joint", {"name": joint.name}), "hardwareInterface").text = interface
    actuator = ET.SubElement(element, "actuator", {"name": f"{joint.name}_actuator"})
    ET.SubElement(actuator, "hardwareInterface").text = interface
    ET.SubElement(actuator, "mechanicalReduction").text = "1"
    ET.SubElement(actuator, "drake:rotor_inertia", {"value": _number(joint.armature)})
    ET.SubElement(actuator, "drake:gear_ratio", {"value": "1"})


def _add_origin(element: ET.Element, pos: np.ndarray, rot: np.ndarray) -> None:
    ET.SubElement(element, "origin", {"xyz": _numbers(pos), "rpy": _numbers(roll_pitch_yaw(rot))})


def roll_pitch_yaw(rot: np.ndarray) -> np.ndarray:
    """Returns roll, pitch and yaw (3,), rad, of a unit quaternion, exact at a pitch of 90° too.

    There only the sum of roll and yaw is defined, so roll is 0.
    """
    matrix = to_matrix(rot / np.linalg.norm(rot))
    level = np.hypot(matrix[0, 0], matrix[1, 0])
    pitch = np.arctan2(-matrix[2, 0], level)
    if level > 1e-7:
        roll, yaw = np.arctan2(matrix[2, 1], matrix[2, 2]), np.arctan2(matrix[1, 0], matrix[0, 0])
    else:
        roll, yaw = 0.0, np.arctan2(-matrix[0, 1], matrix[1, 1])
    return np.array([roll, pitch, yaw])


def _numbers(values: np.ndarray) -> str:
    return " ".join(_number(value) for value in values)


def _number(value: float) -> str:
    """Returns a number with all its digits; -0 is 0."""
    return repr(float(value) + 0.0)

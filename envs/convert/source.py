"""Loads and compiles the source of a conversion: a robot of a scenario, a registered robot, or a file."""

import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco

from envs.convert.packages import read_urdf, unread_visuals
from envs.convert.sidecar import read_sidecar
from envs.core.assets import resolve
from envs.core.errors import ConfigError, unknown_name
from envs.robots import ROBOTS
from envs.scenario import IDENTITY, RobotCfg

logger = logging.getLogger(__name__)

Source = RobotCfg | str | Path
"""A robot, the name of a registered one, an asset reference, or a path to an MJCF or URDF file."""

_USD = (".usd", ".usda", ".usdc", ".usdz")
_READ = (".xml", ".mjcf", ".urdf")
_THIN_MESH = re.compile(r"mesh volume is too small: (\S+)")


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """A compiled source.

    Attributes:
        name: The robot's name, or its file's.
        model: The compiled model.
        prefix: Prefix of the model's names, which a description drops.
        mesh_files: Mesh name to its file, where it has one.
        spec: What the model was compiled from.
        losses: What the source has and MuJoCo did not read, one sentence each.
    """

    name: str
    model: mujoco.MjModel
    prefix: str
    mesh_files: dict[str, Path]
    spec: mujoco.MjSpec
    losses: tuple[str, ...] = ()


def load(
    source: Source, *, root: str | None = None, simplify: bool = False, packages: Path | None = None
) -> Loaded:
    """Reads and compiles a source.

    Args:
        source: See :data:`Source`.
        root: Body of a file that is the robot, where the file holds several; not for a robot.
        simplify: Merge and simplify the visual meshes of a robot, as for our own renderers.
        packages: Folder of the packages that a URDF file names; None looks in the folders above the file.

    Raises:
        ConfigError: if there is no such file, it is USD, or MuJoCo refuses it.
        UnknownNameError: if no robot has that name, or no body of the file the name ``root``.
    """
    if isinstance(source, str) and source in ROBOTS:
        source = ROBOTS.get(source)
    if isinstance(source, RobotCfg):
        return _load_robot(source, simplify)
    if isinstance(source, str) and not re.search(r"[:/.\\]", source):
        raise ROBOTS.unknown(source, hint="Or give a file, as in robot=robot.xml.")
    path = resolve(str(source))
    is_urdf = path.suffix.lower() == ".urdf"
    if path.suffix in _USD:
        raise ConfigError(
            f"'{path.name}' is USD, which is written and not read. Give the robot's MJCF or URDF; the "
            "program that made the USD file may export it."
        )
    if path.suffix.lower() not in _READ:
        raise ConfigError(
            f"'{path.name}' is no file of a robot by its name, which ends in {', '.join(_READ)}."
        )
    try:
        spec = read_urdf(path, packages) if is_urdf else mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ConfigError(f"MuJoCo cannot read {path.name}: {_one_line(error)}") from error
    if is_urdf:
        read_sidecar(spec, path)
    if root is not None:
        _keep_root(spec, root, path.name)
    # A file is named after itself; the folder's name is clearer than robosuite's "robot.xml".
    name = path.parent.name if path.stem == "robot" else path.stem
    model = compile_with_thin_meshes(spec, name)
    files = _mesh_files(spec, {"": path.parent / (spec.meshdir or "")})
    return Loaded(name, model, "", files, spec, unread_visuals(path) if is_urdf else ())


def _load_robot(robot: RobotCfg, simplify: bool) -> Loaded:
    from envs.mjcf.robots import GRIPPER_PREFIX, robot_spec

    spec = robot_spec(replace(robot, pos=(0.0, 0.0, 0.0), rot=IDENTITY), simplify=simplify)
    prefix = f"{robot.name}/"
    model = compile_with_thin_meshes(spec, robot.name)
    folders = {prefix: _mesh_folder(resolve(robot.mjcf))}
    if robot.gripper_mjcf is not None:
        folders[prefix + GRIPPER_PREFIX] = _mesh_folder(resolve(robot.gripper_mjcf))
    return Loaded(robot.name, model, prefix, _mesh_files(spec, folders), spec)


def _mesh_folder(file: Path) -> Path:
    return file.parent / (mujoco.MjSpec.from_file(str(file)).meshdir or "")


def _mesh_files(spec: mujoco.MjSpec, folders: Mapping[str, Path]) -> dict[str, Path]:
    """Finds the file of each mesh, in the folder of the longest prefix that its name has."""
    files = {}
    for mesh in spec.meshes:
        folder = folders[max((prefix for prefix in folders if mesh.name.startswith(prefix)), key=len)]
        if mesh.file and (folder / mesh.file).is_file():
            files[mesh.name] = folder / mesh.file
    return files


def compile_with_thin_meshes(spec: mujoco.MjSpec, name: str) -> mujoco.MjModel:
    """Compiles a model; a mesh without a volume becomes a shell if no mass depends on it.

    robosuite's Sawyer and Baxter have such meshes in links whose inertia their file states.

    Raises:
        ConfigError: if MuJoCo refuses the model.
    """
    # Read before the first attempt: after a failed compilation every access to the spec raises its error.
    known = {mesh.name: mesh for mesh in spec.meshes}
    weighed = {geom.meshname for body in spec.bodies if not body.explicitinertial for geom in body.geoms}
    for _ in range(len(known) + 1):
        try:
            return spec.compile()
        except ValueError as error:
            thin = _THIN_MESH.search(str(error))
            if thin is None or thin[1] not in known or thin[1] in weighed:
                raise ConfigError(f"MuJoCo cannot compile '{name}': {_one_line(error)}") from error
            known[thin[1]].inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    raise AssertionError("each round repairs a mesh")


def _keep_root(spec: mujoco.MjSpec, root: str, file: str) -> None:
    from envs.mjcf.files import keep_only

    body = spec.body(root)
    if body is None:
        names = [item.name for item in spec.bodies if item.name and item.name != "world"]
        raise unknown_name(f"body of {file}", root, names)
    keep_only(spec, body)


def _one_line(error: Exception) -> str:
    return " ".join(line.strip() for line in str(error).splitlines() if line.strip())

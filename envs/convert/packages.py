"""URDF files that name meshes by ROS packages, ``package://<package>/<path>``."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import mujoco

from envs.core.errors import ConfigError

SCHEME = "package://"


def read_urdf(path: Path, packages: Path | None = None) -> mujoco.MjSpec:
    """Reads a URDF file, with its packages in a folder or around the file.

    Args:
        path: The file.
        packages: Folder that holds the packages; None looks in the folders above the file.

    Raises:
        ConfigError: A package, or a file of one, is in none of these folders.
        ValueError: MuJoCo refuses the file.
    """
    text = path.read_text(encoding="utf-8")
    if SCHEME not in text:
        return mujoco.MjSpec.from_file(str(path))
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise ValueError(f"it is no XML: {error}") from error
    compiler = root.find("mujoco/compiler")
    if compiler is None:
        compiler = ET.SubElement(ET.SubElement(root, "mujoco"), "compiler")
    for mesh in _meshes(root, with_visuals=compiler.get("discardvisual") == "false"):
        name = mesh.get("filename", "")
        mesh.set(
            "filename", str(_in_package(name, path, packages) if SCHEME in name else _beside(name, path))
        )
    compiler.set("strippath", "false")  # MuJoCo looks for the bare name of a mesh otherwise
    return mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))


def unread_visuals(path: Path) -> tuple[str, ...]:
    """Returns a sentence about the visual shapes of a URDF file, which MuJoCo reads only where told to."""
    try:
        root = ET.fromstring(path.read_bytes())
    except ET.ParseError:  # MuJoCo's parser is more lenient
        return ()
    compiler = root.find("mujoco/compiler")
    count = sum(1 for _ in root.iterfind("link/visual"))
    if not count or (compiler is not None and compiler.get("discardvisual") == "false"):
        return ()
    return (
        f"Visual shapes ({count}) are left out. To keep them, of files that MuJoCo reads (STL, OBJ), write "
        '<mujoco><compiler discardvisual="false"/></mujoco> into the URDF.',
    )


def _meshes(root: ET.Element, *, with_visuals: bool) -> Iterator[ET.Element]:
    for link in root.iter("link"):
        for part in link:
            if part.tag == "collision" or (part.tag == "visual" and with_visuals):
                yield from part.iter("mesh")


def _in_package(name: str, urdf: Path, packages: Path | None) -> Path:
    package, _, inside = name.removeprefix(SCHEME).partition("/")
    folders = [packages] if packages is not None else list(urdf.resolve().parents)
    for folder in folders:
        for root in (folder / package, folder if folder.name == package else None):
            if root is not None and (root / inside).is_file():
                return (root / inside).resolve()
    where = f"in '{packages}'" if packages is not None else f"in the folders above '{urdf.name}'"
    raise ConfigError(
        f"'{urdf.name}' names the mesh '{name}', and {where} is no '{package}/{inside}'. Name the folder "
        f"that holds the package '{package}': packages=/path/to/folder."
    )


def _beside(name: str, urdf: Path) -> Path:
    given = urdf.resolve().parent / name.removeprefix("file://")
    return given if given.is_file() else given.parent / given.name

"""MJCF of what MuJoCo read: the way back from URDF, and a robot with its gripper in one file."""

import shutil
from pathlib import Path

import mujoco

from envs.convert.source import Loaded
from envs.errors import ConfigError


def write_mjcf(loaded: Loaded, folder: Path) -> Path:
    """Writes ``<name>.xml`` and copies its meshes beside it.

    Args:
        loaded: The source.
        folder: Where to; it exists.

    Returns:
        The file.

    Raises:
        ConfigError: if the source has pictures in files, which only a file that is MJCF already has.
    """
    spec = loaded.spec
    pictures = sorted(texture.file for texture in spec.textures if texture.file)
    if pictures:
        raise ConfigError(
            f"'{loaded.name}' is MJCF already, and its pictures stay where they are: {pictures[0]}."
        )
    meshes = folder / "meshes"
    meshes.mkdir()
    taken: dict[str, Path] = {}
    for mesh in spec.meshes:
        source = loaded.mesh_files.get(mesh.name)
        if source is None:
            continue
        name = source.name
        while taken.get(name, source) != source:
            name = f"_{name}"
        taken[name] = source
        shutil.copyfile(source, meshes / name)
        mesh.file = str(meshes / name)
    path = folder / f"{loaded.name}.xml"
    # MuJoCo reads the meshes once more to write; then their folder is written as this file's own.
    path.write_text(spec.to_xml().replace(f'"{meshes}/', '"meshes/'), encoding="utf-8")
    mujoco.MjSpec.from_file(str(path))  # what was written can be read
    return path

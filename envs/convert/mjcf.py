"""Writes MJCF: from URDF, or a robot with its gripper in one file."""

import ctypes
import logging
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco

from envs.convert.source import Loaded
from envs.core.errors import ConfigError

logger = logging.getLogger(__name__)

DIGITS = 17
"""Significant digits that preserve a double; MuJoCo writes 6, which moves links by micrometres."""


def write_mjcf(loaded: Loaded, folder: Path) -> Path:
    """Writes ``<name>.xml`` and copies its meshes beside it.

    Args:
        loaded: The source.
        folder: Where to; it exists.

    Returns:
        The file.

    Raises:
        ConfigError: if the source has images in files, which only a file that is MJCF already has.
    """
    spec = loaded.spec
    images = sorted(texture.file for texture in spec.textures if texture.file)
    if images:
        raise ConfigError(
            f"'{loaded.name}' is MJCF already, and its images stay where they are: {images[0]}."
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
    # MuJoCo reads the meshes again to write the file; then the folder is replaced by this file's own.
    with all_digits():
        text = spec.to_xml()
    path.write_text(text.replace(f'"{meshes}/', '"meshes/'), encoding="utf-8")
    mujoco.MjSpec.from_file(str(path))  # check that the file can be read
    return path


@contextmanager
def all_digits() -> Iterator[None]:
    """Makes MuJoCo write XML with :data:`DIGITS` digits inside the context.

    Its Python package has no option for that, but its shared library exports the setting.
    """
    folder = Path(mujoco.__file__).parent
    try:
        library = ctypes.CDLL(str(next(file for file in sorted(folder.iterdir()) if _is_library(file))))
        get, put = library._mjPRIVATE__get_xml_precision, library._mjPRIVATE__set_xml_precision
    except (StopIteration, OSError, AttributeError):
        logger.warning("MuJoCo %s writes numbers with 6 digits, not all of them.", mujoco.__version__)
        yield
        return
    before = get()
    put(DIGITS)
    try:
        yield
    finally:
        put(before)


def _is_library(file: Path) -> bool:
    return file.name.startswith(("libmujoco.", "mujoco.dll"))

"""Converts robots to URDF, USD or MJCF, with a cache by content."""

import hashlib
import json
import logging
import os
import shutil
import tempfile
from pathlib import Path

import mujoco
import numpy as np

from envs.convert.description import Description
from envs.convert.read import read_model
from envs.convert.source import Loaded, Source, load
from envs.core.assets import cache_dir
from envs.core.atomic import write_errors
from envs.core.errors import ConfigError, unknown_name

logger = logging.getLogger(__name__)

FORMATS = ("urdf", "usd", "mjcf")
"""``mjcf`` is for sources in URDF, which MuJoCo reads by itself."""

_VERSION = 3
_LOSSES_FILE = "losses.json"


def convert(
    source: Source,
    to: str = "urdf",
    *,
    root: str | None = None,
    simplify: bool = False,
    out: Path | str | None = None,
    packages: Path | None = None,
) -> Path:
    """Converts a robot, or returns the cached conversion.

    Each call logs what the format cannot represent as a warning.

    Args:
        source: A robot of a scenario, the name of a registered one, or a path to an MJCF (or URDF) file.
        to: ``"urdf"``, ``"usd"`` or ``"mjcf"``.
        root: Body of a file that is the robot, where the file holds several.
        simplify: Merge and simplify a robot's visual meshes, as for our own renderers.
        out: Folder to write to, which must not exist or be empty; None is a cache, by content.
        packages: Folder of the ROS packages that a URDF file names (``package://``); None looks in the
            folders above the file.

    Returns:
        The file: ``<name>.urdf``, ``<name>.usd`` or ``<name>.xml``, its meshes beside it, and beside URDF
        ``<name>.mujoco.json`` with the actuators, armature and free base that ``to="mjcf"`` reads.

    Raises:
        UnknownNameError: if there is no such format, robot or body.
        ConfigError: if the source is not one robot, or the format does not support one of its joints.
        MissingExtraError: if ``to="usd"`` and usd-core is not installed.
        WriteError: if the disk is full or the folder cannot be written.
    """
    if to not in FORMATS:
        raise unknown_name("format", to, FORMATS)
    loaded = load(source, root=root, simplify=simplify, packages=packages)
    if out is None:
        folder = cache_dir("convert") / f"{loaded.name}-{to}-{_digest(loaded, to)}"
    else:
        folder = Path(out)
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise ConfigError(f"out={folder} exists already and is not an empty folder. Choose another one.")
    if out is not None or not (folder / _LOSSES_FILE).is_file():
        with write_errors(folder):
            _write_whole(loaded, to, folder)
    for loss in json.loads((folder / _LOSSES_FILE).read_text(encoding="utf-8")):
        logger.warning("%s to %s: %s", loaded.name, to, loss)
    return folder / f"{loaded.name}.{'xml' if to == 'mjcf' else to}"


def describe(source: Source, *, root: str | None = None, simplify: bool = False) -> Description:
    """Returns what :func:`convert` writes; same arguments."""
    return describe_loaded(load(source, root=root, simplify=simplify))


def describe_loaded(loaded: Loaded) -> Description:
    """Returns the description of what :func:`envs.convert.source.load` read."""
    return read_model(loaded.model, loaded.name, prefix=loaded.prefix, mesh_files=loaded.mesh_files)


def _write_whole(loaded: Loaded, to: str, folder: Path) -> None:
    """Writes into a temporary folder and renames it when it is complete."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    working = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        losses = (*loaded.losses, *_write(loaded, to, working))
        (working / _LOSSES_FILE).write_text(json.dumps(losses, indent=1), encoding="utf-8")
        working.chmod(0o755)
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
        try:
            os.rename(working, folder)
        except OSError:
            if not (folder / _LOSSES_FILE).is_file():  # another process may have been faster
                raise
    finally:
        shutil.rmtree(working, ignore_errors=True)


def _write(loaded: Loaded, to: str, folder: Path) -> tuple[str, ...]:
    """Writes the files; returns what the format leaves out."""
    if to == "mjcf":
        from envs.convert.mjcf import write_mjcf

        write_mjcf(loaded, folder)
        return ()
    description = describe_loaded(loaded)
    if to == "urdf":
        from envs.convert.sidecar import write_sidecar
        from envs.convert.urdf import write_urdf

        written = write_urdf(description, folder)
        return (*description.losses, *write_sidecar(loaded.model, loaded.prefix, description, written))
    from envs.convert.usd import write_usd

    return (*description.losses, *write_usd(description, folder))


def _digest(loaded: Loaded, to: str) -> str:
    """Returns a hash of the content: the compiled model and the textured variants of its meshes."""
    buffer = np.empty(mujoco.mj_sizeModel(loaded.model), np.uint8)
    mujoco.mj_saveModel(loaded.model, None, buffer)
    digest = hashlib.sha256(json.dumps([_VERSION, to, mujoco.__version__]).encode())
    digest.update(buffer.tobytes() + "".join(loaded.losses).encode())
    for name, path in sorted(loaded.mesh_files.items()):
        twin = path.with_suffix(".obj")
        if path.suffix != ".obj" and twin.is_file():
            digest.update(name.encode() + twin.read_bytes())
    return digest.hexdigest()[:24]

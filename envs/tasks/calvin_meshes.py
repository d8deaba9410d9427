"""CALVIN's play table A from its own meshes, for those who have them (``mees/calvin_env``, ``data``).

A simulator touches a mesh as its convex hull. The desk is far from convex: CoACD cuts it into convex
pieces (Wei et al., "Approximate Convex Decomposition for 3D Meshes with Collision-Aware Concavity and
Tree Search", arXiv:2205.02961), which are kept in the cache. Of the moving parts CALVIN brings pieces.
"""

import hashlib
import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from envs.core.assets import cache_dir
from envs.core.atomic import cached_directory
from envs.core.errors import ConfigError, MissingExtraError
from envs.core.extras import install_command
from envs.scenario import GeomCfg, LinkCfg, Rgba, Vec3
from envs.tasks.calvin_table import SCALE, about_x, link, scaled

if TYPE_CHECKING:
    import trimesh

logger = logging.getLogger(__name__)

URDF = "calvin_table_A/urdf/calvin_table_A.urdf"

CONCAVITY = 0.03
"""CoACD's threshold. At its default of 0.05 the desk bulges by 2 cm beside the button."""

DESK = 0.55
"""Height of the desk in the mesh's frame, m, before scaling."""

LEVEL_M = 0.01
"""A piece that rises above the desk by less is cut off there, so that blocks stand level."""

_VERSION = 2

_MASSES_KG = {"slide": 1.543, "drawer": 4.231, "button": 0.154, "switch": 0.239}
"""Of the URDF."""

_FIXED: dict[str, tuple[Vec3, Rgba]] = {
    "plank_link.obj": ((-0.125, 0.1125, 0.525), (1.0, 1.0, 1.0, 1.0)),
    "led_link.STL": ((-0.35, 0.2, 0.80981), (0.1, 0.35, 0.12, 1.0)),
    "light_link.STL": ((0.375, 0.165, 0.80981), (0.85, 0.8, 0.4, 1.0)),
}
"""Parts that are fixed to the desk, turned by 90° about x."""


def mesh_table(calvin_dir: str) -> tuple[tuple[GeomCfg, ...], tuple[LinkCfg, ...]]:
    """Returns the geoms that do not move, and the links, of the table in a folder.

    Args:
        calvin_dir: The folder ``data`` of CALVIN's environment, or the one above it.

    Raises:
        ConfigError: if the folder does not hold the table.
        MissingExtraError: if CoACD is needed and not installed.
    """
    root = _find(calvin_dir)
    meshes, wood = root / "meshes", str(root / "textures" / "dark_wood.png")
    handle = str(root / "textures" / "dark_wood__gray_handle.png")
    base = [_seen(meshes / "base_link.obj", wood), *_touched(_decomposed(meshes / "base_link.obj"))]
    for name, (pos, rgba) in _FIXED.items():
        seen = {"mesh": str(meshes / name), "texture": wood if name.startswith("plank") else None}
        base.append(_mesh(**seen, pos=scaled(pos), rot=about_x(np.pi / 2), rgba=rgba, collides=True))
    links = []
    for part, image in (("slide", handle), ("drawer", handle), ("button", None), ("switch", None)):
        seen_file = meshes / f"{part}_link.{'STL' if part == 'button' else 'obj'}"
        rgba = (0.08, 0.08, 0.09, 1.0) if part == "button" else (0.62, 0.62, 0.64, 1.0)
        pieces = [seen_file] if part == "button" else _split(meshes / f"{part}_link_vhacd2.obj")
        geoms = (_seen(seen_file, image, rgba), *_touched(pieces, _MASSES_KG[part]))
        links.append(link(f"base__{part}", geoms))
    return tuple(base), tuple(links)


def _find(calvin_dir: str) -> Path:
    given = Path(calvin_dir).expanduser()
    for folder in (given, given / "data"):
        if (folder / URDF).is_file():
            return (folder / URDF).parent.parent.resolve()
    raise ConfigError(
        f"calvin_dir={calvin_dir} holds no {URDF}. Give the folder 'data' of CALVIN's environment "
        "(https://github.com/mees/calvin_env), or leave calvin_dir out: the table is then built from boxes."
    )


def _mesh(**values) -> GeomCfg:
    return GeomCfg(shape="mesh", size=(SCALE, SCALE, SCALE), **values)


def _seen(file: Path, texture: str | None, rgba: Rgba = (1.0, 1.0, 1.0, 1.0)) -> GeomCfg:
    rgba = rgba if texture is None else (1.0, 1.0, 1.0, 1.0)
    return _mesh(mesh=str(file), texture=texture, rgba=rgba, collides=False)


def _touched(files: Sequence[Path], mass_kg: float = 0.0) -> list[GeomCfg]:
    return [_mesh(mesh=str(file), mass_kg=mass_kg / len(files), visible=False) for file in files]


def _split(file: Path) -> list[Path]:
    """Returns the objects of an OBJ file, each in a file of its own."""
    import trimesh

    def pieces() -> "list[trimesh.Trimesh]":
        scene = trimesh.load_scene(file, split_objects=True, group_material=False)
        return [_hull(piece.vertices) for _, piece in sorted(scene.geometry.items())]

    return _cached(file, "split", pieces)


def _decomposed(file: Path) -> list[Path]:
    """Returns the convex pieces of a mesh."""

    def pieces() -> "list[trimesh.Trimesh]":
        import trimesh

        try:
            import coacd  # pyright: ignore[reportMissingImports]
        except ModuleNotFoundError:
            raise MissingExtraError(
                "CALVIN's table needs the package 'coacd', which is not installed. "
                f"Install it with: {install_command('calvin')}"
            ) from None
        logger.info("Cutting %s into convex pieces; this takes a minute, once.", file.name)
        mesh = trimesh.load_mesh(file)
        mesh.merge_vertices(merge_norm=True, merge_tex=True)
        coacd.set_log_level("error")
        parts = coacd.run_coacd(coacd.Mesh(mesh.vertices, mesh.faces), threshold=CONCAVITY, seed=0)
        return [_hull(_level(vertices)) for vertices, _ in parts]

    return _cached(file, f"coacd {CONCAVITY}", pieces)


def _hull(vertices: np.ndarray) -> "trimesh.Trimesh":
    """Returns the convex hull of points (V, 3), rounded to 0.1 mm.

    Faces that are level but for rounding errors would stay in pieces, through which a block can sink.
    """
    import trimesh

    return trimesh.convex.convex_hull(np.round(vertices, 4))


def _level(vertices: np.ndarray) -> np.ndarray:
    """Cuts a piece (V, 3) off at the desk if it starts below and rises slightly above it."""
    heights = vertices[:, 2]
    if heights.min() < DESK - LEVEL_M and heights.max() < DESK + LEVEL_M:
        vertices = vertices.copy()
        vertices[:, 2] = heights.clip(max=DESK)
    return vertices


def _cached(file: Path, how: str, make: "Callable[[], list[trimesh.Trimesh]]") -> list[Path]:
    """Returns the files of the meshes that ``make`` returns, made only where there are none."""
    digest = hashlib.sha256(f"{_VERSION} {how} ".encode() + file.read_bytes()).hexdigest()[:32]
    folder = cache_dir("calvin") / digest
    if not folder.is_dir():
        with cached_directory(folder) as whole:
            for index, piece in enumerate(make()):
                piece.export(whole / f"{index:03d}.stl")
    return sorted(folder.glob("*.stl"))

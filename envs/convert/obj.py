"""Writes meshes and materials as Wavefront files, which every URDF loader reads."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from envs.convert.description import Material, Mesh


def write_obj(path: Path, mesh: Mesh, material: Material | None) -> None:
    """Writes a mesh; with a material, an .mtl and its image beside it.

    Args:
        path: The .obj file.
        mesh: The mesh.
        material: Its appearance, or None for a collision mesh.
    """
    lines = [_rows("v", mesh.vertices)]
    if material is not None:
        material_path = path.with_suffix(".mtl")
        write_mtl(material_path, material)
        lines.insert(0, f"mtllib {material_path.name}\n")
        if mesh.uvs is not None:
            lines.append(_rows("vt", mesh.uvs[0]))
        if mesh.normals is not None:
            lines.append(_rows("vn", mesh.normals[0]))
        lines.append(f"usemtl {material.name.replace(' ', '_')}\n")
    lines.append(_faces(mesh, seen=material is not None))
    path.write_text("".join(lines), encoding="utf-8")


def write_mtl(path: Path, material: Material) -> None:
    """Writes a material, and its image as a PNG file of the same name."""
    red, green, blue, alpha = material.rgba
    colour = f"{red:g} {green:g} {blue:g}"
    lines = [f"newmtl {material.name.replace(' ', '_')}", f"Kd {colour}", f"Ka {colour}", "Ks 0.1 0.1 0.1"]
    lines += [f"d {alpha:g}", "Ns 20"]
    if material.image is not None:
        write_image(path.with_suffix(".png"), material.image)
        lines.append(f"map_Kd {path.with_suffix('.png').name}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_image(path: Path, image: np.ndarray) -> None:
    """Writes an image (H, W, 3) uint8."""
    Image.fromarray(image).save(path)


def _rows(kind: str, values: np.ndarray) -> str:
    """One line per row; nine digits preserve single precision."""
    row = f"{kind} " + " ".join(["%.9g"] * values.shape[1]) + "\n"
    return (row * len(values)) % tuple(values.ravel().tolist())


def _faces(mesh: Mesh, *, seen: bool) -> str:
    """Faces as ``vertex/texture/normal`` with the indices that exist, counted from 1."""
    columns: list[np.ndarray] = [mesh.faces]
    pattern = "%d"
    uvs, normals = (mesh.uvs, mesh.normals) if seen else (None, None)
    if uvs is not None:
        columns.append(uvs[1])
        pattern += "/%d"
    if normals is not None:
        columns.append(normals[1])
        pattern += "/%d" if uvs is not None else "//%d"
    corners = np.stack(columns, axis=-1) + 1  # (F, 3, indices)
    row = "f " + " ".join([pattern] * 3) + "\n"
    return (row * len(corners)) % tuple(corners.ravel().tolist())


def mesh_files(folder: Path, pairs: Sequence[tuple[Mesh, Material | None]]) -> dict[tuple[int, int], str]:
    """Writes every pair of a mesh and its material once.

    Args:
        folder: Where to; it exists.
        pairs: Meshes, each with its material, or None for a collision mesh.

    Returns:
        ``(id(mesh), id(material))`` to the name of the file in the folder.
    """
    names: dict[tuple[int, int], str] = {}
    taken: set[str] = set()
    for mesh, material in pairs:
        key = (id(mesh), id(material))
        if key in names:
            continue
        stem = "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in mesh.name)
        name, number = f"{stem}.obj", 2
        while name in taken:
            name, number = f"{stem}_{number}.obj", number + 1
        taken.add(name)
        names[key] = name
        write_obj(folder / name, mesh, material)
    return names

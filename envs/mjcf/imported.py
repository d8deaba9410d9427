"""Objects of other projects' MJCF files: cleaned, simplified once, and kept in a cache.

A file of another benchmark is made for that benchmark: it has meshes of tens of thousands of triangles,
options of a simulator, and parts that only its own loader mends. :func:`imported` writes the object that it
describes as a file that stands alone. Meshes, images and files are named by their content, so nothing is made
twice, and a changed source is made again.
"""

import hashlib
import json
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from envs.core.assets import cache_dir
from envs.core.atomic import atomic_path, write_file
from envs.core.errors import ConfigError
from envs.mjcf.baking import baked
from envs.mjcf.meshes import content_digest
from envs.mjcf.recolour import recoloured
from envs.mjcf.textured_mesh import TexturedMesh, box_mesh

MAX_IMAGE_SIZE = 512
"""Pixels along the longer side of a texture; see :data:`envs.mjcf.objects.MAX_TEXTURE_SIZE`."""

LEAST_FACES = 64
"""Triangles that a mesh may have, however small its share."""

_VERSION = 6
_KEPT = {"body", "geom", "joint", "freejoint", "inertial", "site"}
Edit = Callable[[ET.Element], None]
"""Changes a file's tree before it is cleaned."""


def imported(
    source: Path,
    *,
    root: str = "object",
    max_faces: int = 2000,
    image_size: int = MAX_IMAGE_SIZE,
    free: bool = False,
    edit: Edit | None = None,
    colour: str | None = None,
) -> Path:
    """Returns a file of the cache that has one object of another MJCF file, and nothing else.

    Args:
        source: The file.
        root: Its body that is the object.
        max_faces: Triangles that its meshes share, by how many they have.
        image_size: Pixels along a side of the image of a simplified mesh.
        free: Whether the object moves freely; its joint has the damping that robosuite gives it.
        edit: Changes the file's tree first.
        colour: Most frequent colour of its images, in place of theirs (:mod:`envs.mjcf.recolour`).

    Raises:
        ConfigError: The file, or a mesh or an image of it, cannot be read.
    """
    tree = _parsed(source)
    if edit is not None:
        edit(tree)
    body = next((item for item in tree.iter("body") if item.get("name") == root), None)
    if body is None:
        raise ConfigError(f"{source} has no body '{root}'.")
    folder = source.parent / (_compiler(tree).get("meshdir") or "")
    assets = _Assets(tree, folder, source, body, colour)
    out = ET.Element("mujoco", model=source.stem)
    # Only what collides has mass, in MuJoCo's own terms too: robosuite compiles with inertiagrouprange="0 0".
    ET.SubElement(out, "compiler", angle=_compiler(tree).get("angle", "radian"), autolimits="true")
    assets.simplify(max_faces, image_size)
    cleaned = _cleaned(body, assets)
    out.append(_defaults(tree))
    out.append(assets.element())
    world = ET.SubElement(out, "worldbody")
    world.append(cleaned)
    if free:
        ET.SubElement(world[0], "joint", name="free", type="free", damping="0.0005")
    text = ET.tostring(out, encoding="unicode").encode()
    name = hashlib.sha256(json.dumps([_VERSION]).encode() + text).hexdigest()[:32]
    path = cache_dir("objects") / f"{name}.xml"
    if not path.is_file():
        write_file(path, text)
    return path


def _parsed(source: Path) -> ET.Element:
    try:
        return ET.parse(source).getroot()
    except (OSError, ET.ParseError) as error:
        raise ConfigError(f"The MJCF file {source} cannot be read: {error}.") from error


def _compiler(tree: ET.Element) -> dict[str, str]:
    found = tree.find("compiler")
    return {} if found is None else found.attrib


def _defaults(tree: ET.Element) -> ET.Element:
    """Returns the file's classes of defaults, without stray text."""
    classes = tree.find("default")
    out = ET.Element("default") if classes is None else classes
    for item in out.iter():
        item.text = item.tail = None
    return out


def _cleaned(body: ET.Element, assets: "_Assets") -> ET.Element:
    """Copies a body without what only its own project reads."""
    out = ET.Element("body", {k: v for k, v in body.attrib.items() if k != "childclass"})
    for item in body:
        if item.tag == "body":
            out.append(_cleaned(item, assets))
        elif item.tag == "geom":
            out.append(assets.geom(item))
        elif item.tag in _KEPT:
            out.append(ET.Element(item.tag, item.attrib))
    return out


class _Assets:
    """The meshes, images and materials that an object uses."""

    def __init__(
        self, tree: ET.Element, folder: Path, source: Path, body: ET.Element, colour: str | None
    ) -> None:
        self._folder, self._source, self._colour = folder, source, colour
        self._classes = {item.get("class"): item.find("geom") for item in tree.iter("default")}
        self._found: dict[str, dict[str, ET.Element]] = {"mesh": {}, "texture": {}, "material": {}}
        for item in tree.iterfind("asset/*"):
            if item.tag in self._found:  # a name that comes twice keeps its first meaning
                name = item.get("name") or Path(item.get("file", "")).stem
                self._found[item.tag].setdefault(name, item)
        geoms = list(body.iter("geom"))
        self._boxes: dict[str, TexturedMesh] = {}
        self._files: dict[str, str] = {}
        self._baked: dict[str, str] = {}
        self._meshes = {
            name: self._of(geom, "material") for geom in geoms if (name := self._of(geom, "mesh"))
        }
        self._materials = dict.fromkeys(name for geom in geoms if (name := self._of(geom, "material")))

    def _of(self, geom: ET.Element, key: str) -> str | None:
        default = self._classes.get(geom.get("class"))
        return geom.get(key) or (default.get(key) if default is not None else None)

    def geom(self, geom: ET.Element) -> ET.Element:
        """Copies a geom; one that is only seen weighs nothing, and a textured box becomes a mesh."""
        out = ET.Element("geom", geom.attrib)
        group, contype, conaffinity = (self._of(geom, key) for key in ("group", "contype", "conaffinity"))
        if group == "1":
            out.set("mass", "0")
        if (mesh := self._of(geom, "mesh")) in self._baked:
            out.set("material", f"{mesh}_baked")
        material = self._found["material"].get(geom.get("material", ""))
        is_seen_only = contype == "0" and conaffinity == "0"
        is_seen_box = is_seen_only and geom.get("type") in ("box", "plane")
        if is_seen_box and material is not None and self._image(material) is not None:
            half = np.array(geom.get("size", "").split(), float)
            if geom.get("type") == "plane":
                half[2] = 0.002
            counts = tuple(float(word) for word in material.get("texrepeat", "1 1").split())
            if material.get("texuniform") != "true":
                counts = tuple(count / (2 * side) for count, side in zip(counts, half[:2], strict=True))
            mesh = box_mesh(half, (counts[0], counts[1]))
            name = f"box{len(self._boxes)}"
            self._boxes[name] = mesh
            out.set("type", "mesh")
            out.set("mesh", name)
            out.attrib.pop("size")
        return out

    def _image(self, material: ET.Element) -> ET.Element | None:
        image = self._found["texture"].get(material.get("texture", ""))
        return image if image is not None and image.get("file") else None

    def simplify(self, max_faces: int, image_size: int) -> None:
        """Writes every mesh into the cache, with an image of its own where it is simplified."""
        paths = {name: self._path(self._found["mesh"][name]) for name in self._meshes}
        sizes = {name: path.stat().st_size for name, path in paths.items()}
        for name, path in paths.items():
            budget = max(LEAST_FACES, max_faces * sizes[name] // max(1, sum(sizes.values())))
            material = self._found["material"].get(self._meshes[name] or "")
            image = None if material is None else self._image(material)
            flat = image is None or image.get("type") == "cube"
            texture = None if flat or image is None else self._image_path(image)
            self._files[name], baked = _mesh_files(path, texture, budget, image_size)
            if baked is not None:
                self._baked[name] = baked

    def element(self) -> ET.Element:
        """Returns the element that names what is used."""
        out = ET.Element("asset")
        for name, file in self._files.items():
            scale = self._found["mesh"][name].get("scale", "1 1 1")
            ET.SubElement(out, "mesh", name=name, file=file, scale=scale)
        for name, mesh in self._boxes.items():
            content = mesh.msh()
            file = cache_dir("meshes") / f"{hashlib.sha256(content).hexdigest()[:32]}.msh"
            if not file.is_file():
                write_file(file, content)
            ET.SubElement(out, "mesh", name=name, file=f"../meshes/{file.name}")
        for name, file in self._baked.items():
            ET.SubElement(out, "texture", name=f"{name}_baked", type="2d", file=file)
            ET.SubElement(out, "material", name=f"{name}_baked", texture=f"{name}_baked")
        for name in self._materials:
            if name in self._found["material"]:
                self._add_material(out, name, self._found["material"][name])
        return out

    def _add_material(self, out: ET.Element, name: str, material: ET.Element) -> None:
        image = self._image(material)
        added = ET.SubElement(out, "material", name=name, rgba=material.get("rgba", "1 1 1 1"))
        if image is None:
            return
        file, mean = self._image_file(self._image_path(image))
        if image.get("type") == "cube":  # its mapping needs no coordinates: a colour
            added.set("rgba", " ".join(f"{value:.3f}" for value in (*mean, 1.0)))
            return
        if not any(item.tag == "texture" and item.get("name") == image.get("name") for item in out):
            ET.SubElement(out, "texture", name=image.get("name", name), type="2d", file=file)
        added.set("texture", image.get("name", name))

    def _path(self, item: ET.Element) -> Path:
        path = self._folder / item.get("file", "")
        if not path.is_file():
            raise ConfigError(f"{self._source} names a file that is not there: {path}.")
        return path

    def _image_path(self, item: ET.Element) -> Path:
        path = self._path(item)
        return path if self._colour is None else _recoloured_file(path, self._colour)

    def _image_file(self, path: Path) -> tuple[str, np.ndarray]:
        file = _cached_image(path, MAX_IMAGE_SIZE)
        if not file.is_file():
            image = read_image(path)
            image.thumbnail((MAX_IMAGE_SIZE, MAX_IMAGE_SIZE))
            _save(image, file)
        with Image.open(file) as image:
            mean = np.asarray(image.resize((1, 1), Image.Resampling.BOX), float)[0, 0, :3] / 255.0
        return f"../images/{file.name}", mean


def _mesh_files(path: Path, texture: Path | None, budget: int, size: int) -> tuple[str, str | None]:
    """Returns the files of a mesh of about ``budget`` triangles and of the image made for it, if any."""
    key = json.dumps([_VERSION, budget, size]).encode() + content_digest(path)
    key += b"" if texture is None else content_digest(texture)
    name = hashlib.sha256(key).hexdigest()[:32]
    file, image = cache_dir("meshes") / f"{name}.msh", cache_dir("images") / f"{name}.png"
    if not file.is_file():
        dense = TexturedMesh.read(path)
        mesh = dense.simplified(budget)
        if texture is not None and mesh.uv is None and dense.uv is not None:
            mesh, pixels = baked(mesh, dense, np.asarray(read_image(texture)), size)
            _save(Image.fromarray(pixels), image)
        write_file(file, mesh.msh())
    return f"../meshes/{file.name}", f"../images/{image.name}" if image.is_file() else None


def _cached_image(path: Path, change: object) -> Path:
    """Returns the file of the cache for an image after a change."""
    key = content_digest(path) + json.dumps([_VERSION, change]).encode()
    return cache_dir("images") / f"{hashlib.sha256(key).hexdigest()[:32]}.png"


def _recoloured_file(path: Path, colour: str) -> Path:
    file = _cached_image(path, colour)
    if not file.is_file():
        _save(recoloured(read_image(path), colour), file)
    return file


def read_image(path: Path) -> Image.Image:
    """Returns an image in RGB.

    Raises:
        ConfigError: It cannot be read.
    """
    try:
        with Image.open(path) as image:
            return image.convert("RGB")
    except (OSError, UnidentifiedImageError) as error:
        raise ConfigError(f"The image {path} cannot be read: {error}.") from error


def _save(image: Image.Image, file: Path) -> None:
    with atomic_path(file, keep_suffix=True) as partial:
        image.save(partial, "PNG", compress_level=1)  # a fifth of the time, for a quarter more bytes

"""The library of materials: those allowed for each surface, and their images.

By default every material is computed from its name (:mod:`envs.randomization.procedural`). A folder of
image files replaces or extends them.
"""

import functools
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from envs.core.errors import ConfigError, unknown_name
from envs.randomization import procedural
from envs.scenario import SURFACES

IMAGE_SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")

_TABLE_SIZE_M = (0.6, 1.2)
_ROOM_SIZE_M = (1.0, 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class MaterialLibrary:
    """Materials by surface.

    Attributes:
        names: Surface to the names of its materials. An image's name is its path inside ``folder``.
        folder: Where image files lie, or None when every material is procedural.
    """

    names: Mapping[str, tuple[str, ...]]
    folder: Path | None = None

    @classmethod
    def built_in(cls) -> "MaterialLibrary":
        """Returns the built-in library: 300 table, 150 wall and 150 ground materials."""
        names = {surface: procedural.surface_names(i) for i, surface in enumerate(SURFACES)}
        return cls(MappingProxyType(names))

    @classmethod
    def chosen(cls, materials: str | Path | None) -> "MaterialLibrary":
        """Returns the library that a setting names.

        Args:
            materials: A folder of images that replace the built-in materials, ``+`` and a folder of
                images that are added to them, or None or ``""`` for the built-in ones.

        Raises:
            ConfigError: as :meth:`from_folder`.
        """
        words = str(materials or "")
        if not words:
            return cls.built_in()
        return cls.from_folder(words.removeprefix("+"), extend=words.startswith("+"))

    @classmethod
    def from_folder(cls, path: str | Path, *, extend: bool = False) -> "MaterialLibrary":
        """Reads a folder of images.

        Subfolders ``table``, ``wall`` and ``ground`` hold a surface's images; a surface without
        subfolder keeps its procedural materials. A folder without any of them serves every surface.

        Args:
            path: The folder.
            extend: Keep the procedural materials beside the images.

        Raises:
            ConfigError: if the folder does not exist, holds no image, or one cannot be read.
        """
        folder = Path(path)
        if not folder.is_dir():
            raise ConfigError(f"No folder of materials at '{folder}'. {_FOLDER_HELP}")
        built_in = cls.built_in().names
        has_subfolders = any((folder / surface).is_dir() for surface in SURFACES)
        names: dict[str, tuple[str, ...]] = {}
        for surface in SURFACES:
            within = folder / surface if has_subfolders else folder
            images = _image_names(folder, within) if within.is_dir() else ()
            names[surface] = (*(built_in[surface] if extend or not images else ()), *images)
        if all(names[surface] == built_in[surface] for surface in SURFACES):
            raise ConfigError(f"The folder of materials '{folder}' holds no image. {_FOLDER_HELP}")
        return cls(MappingProxyType(names), folder)

    def __reduce__(self) -> tuple:
        """Makes it picklable for another process, which a read-only mapping is not."""
        return _library, (dict(self.names), self.folder)

    def texture(self, name: str, size: int = procedural.NATIVE_SIZE) -> np.ndarray:
        """Returns a material's image, read-only (size, size, 3) uint8 sRGB.

        Raises:
            UnknownNameError: if the library has no such material.
            ConfigError: if its file cannot be read.
        """
        if self.folder is None or not self.is_image(name):
            return procedural.texture(name, size)
        return _image_texture(self.folder, name, size)

    def is_image(self, name: str) -> bool:
        """Returns whether a material is a file; only a file's name ends as an image's.

        Raises:
            UnknownNameError: if it looks like a file and the library has no such file.
        """
        if not _names_a_file(name):
            return False
        if not any(name in names for names in self.names.values()):
            images = {each for names in self.names.values() for each in names if _names_a_file(each)}
            raise unknown_name("material", name, images)
        return True

    def size_range_m(self, name: str, surface: str) -> tuple[float, float]:
        """Returns the range of the side of the square that one copy of the image covers, m."""
        if self.is_image(name):
            return _TABLE_SIZE_M if surface == "table" else _ROOM_SIZE_M
        low, high = procedural.parse(name)[0].size_m
        return (low, min(high, _TABLE_SIZE_M[1])) if surface == "table" else (low, high)

    def digest(self) -> str:
        """Returns the first 16 hexadecimal digits of a SHA-256 over every name and every file's content."""
        sha = hashlib.sha256(f"procedural {procedural.VERSION}".encode())
        for surface in SURFACES:
            for name in self.names[surface]:
                sha.update(f"\n{surface} {name}".encode())
                if self.folder is not None and self.is_image(name):
                    sha.update(hashlib.sha256((self.folder / name).read_bytes()).digest())
        return sha.hexdigest()[:16]


def _names_a_file(name: str) -> bool:
    """Returns whether a name ends as an image's; no path is made of it, for episodes ask this often."""
    return name.lower().endswith(IMAGE_SUFFIXES)


def _library(names: dict[str, tuple[str, ...]], folder: Path | None) -> MaterialLibrary:
    return MaterialLibrary(MappingProxyType(names), folder)


_FOLDER_HELP = (
    f"Give a folder with image files ({', '.join(IMAGE_SUFFIXES)}), either directly in it or in "
    "subfolders table/, wall/ and ground/."
)


def _image_names(root: Path, folder: Path) -> tuple[str, ...]:
    """Returns the paths, inside ``root``, of the folder's images, after checking that each opens."""
    from PIL import Image

    names = []
    for path in sorted(folder.iterdir()):
        if not _names_a_file(path.name) or not path.is_file():
            continue
        try:
            with Image.open(path) as image:
                image.verify()
        except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
            raise _unreadable(path, error) from error
        names.append(path.relative_to(root).as_posix())
    return tuple(names)


@functools.lru_cache(maxsize=64)
def _image_texture(folder: Path, name: str, size: int) -> np.ndarray:
    """Cuts the middle square out of an image and scales it."""
    from PIL import Image, ImageOps

    try:
        with Image.open(folder / name) as image:
            square = ImageOps.fit(image.convert("RGB"), (size, size), Image.Resampling.LANCZOS)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise _unreadable(folder / name, error) from error
    pixels = np.asarray(square, dtype=np.uint8)
    pixels.setflags(write=False)
    return pixels


def _unreadable(path: Path, error: Exception) -> ConfigError:
    return ConfigError(f"The material '{path}' cannot be read as an image ({error}). Replace or remove it.")

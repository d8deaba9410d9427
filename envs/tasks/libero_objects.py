"""The objects of LIBERO's chocolate pudding scene: as primitives, or as LIBERO's own meshes.

LIBERO (Liu et al., "LIBERO: Benchmarking Knowledge Transfer for Lifelong Robot Learning", arXiv
2306.03310; code MIT) takes its groceries from HOPE and its basket from Google's scanned objects. Neither
is part of this project: without a copy of LIBERO every object consists of a few primitives of its size.
Body frames are LIBERO's in both cases, so that poses mean the same; so are masses (collision boxes at
100 kg/m³) and friction.
"""

import io
import math
import pickletools
import xml.etree.ElementTree as ET
import zipfile
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from envs.core.errors import ConfigError
from envs.rotations import conjugate, multiply, rotate, to_matrix
from envs.scenario import GeomCfg, ObjectCfg, Quat, Rgba

DENSITY = 100.0
"""kg/m³, of every collision box of LIBERO's files."""

FRICTION = (0.95, 0.3, 0.1)
"""Of every collision box of LIBERO's files."""

_TASK = "pick_up_the_chocolate_pudding_and_place_it_in_the_basket"
INIT_STATES = f"init_files/libero_object/{_TASK}.pruned_init"
"""Path of this task's 50 initial states in a copy of LIBERO, below ``libero/libero``."""

INIT_WIDTH = 110
"""Numbers of one state: time, 9 joints of the robot, 7 poses of 7 numbers, and 51 velocities."""

_S = math.sqrt(0.5)
_Y_IS_UP: Quat = (0.5, 0.5, 0.5, 0.5)
_QUARTER: Quat = (_S, 0.0, 0.0, _S)

_CARDBOARD: Rgba = (0.42, 0.24, 0.10, 1.0)
_WICKER: Rgba = (0.62, 0.44, 0.24, 1.0)


@dataclass(frozen=True, slots=True)
class Part:
    """A primitive of an object at rest.

    Attributes:
        shape: ``box`` (half sizes) or ``cylinder`` (radius, half height).
        size: Sizes, m.
        pos: Its middle, from the body's origin along the world's axes, m.
        rgba: Colour.
        collides: Whether it is touched.
    """

    shape: str
    size: tuple[float, ...]
    pos: tuple[float, float, float]
    rgba: Rgba
    collides: bool = True


@dataclass(frozen=True, slots=True)
class Grocery:
    """One object.

    Attributes:
        name: LIBERO's name, and that of its folder.
        rest_rot: Orientation in which LIBERO puts it, wxyz (measured from its initial states).
        mass_kg: Of LIBERO's collision boxes.
        parts: The primitives, in the orientation of rest.
        family: LIBERO's folder of assets.
    """

    name: str
    rest_rot: Quat
    mass_kg: float
    parts: tuple[Part, ...] = field(repr=False)
    family: str = "stable_hope_objects"

    @property
    def radius_m(self) -> float:
        """Radius of a circle about the body's origin that holds its outline seen from above, m."""
        return max(_reach(part) for part in self.parts if part.collides)

    def primitives(self) -> tuple[GeomCfg, ...]:
        """Returns the primitives in the body's frame; the mass is shared by volume."""
        volumes = [_volume(part) if part.collides else 0.0 for part in self.parts]
        back = conjugate(np.array(self.rest_rot))
        return tuple(
            GeomCfg(
                shape="box" if part.shape == "box" else "cylinder",
                size=part.size,
                pos=_triple(rotate(back, np.array(part.pos))),
                rot=_quat(back),
                rgba=part.rgba,
                mass_kg=self.mass_kg * volume / sum(volumes),
                friction=FRICTION,
                collides=part.collides,
            )
            for part, volume in zip(self.parts, volumes, strict=True)
        )

    def scanned(self, libero: Path) -> tuple[GeomCfg, ...]:
        """Returns LIBERO's collision boxes and, where its files are there, its textured mesh.

        Args:
            libero: The folder of LIBERO that has ``assets``.
        """
        folder = libero / "assets" / self.family / self.name
        root = _parse(folder / f"{self.name}.xml")
        mesh, texture = root.find("asset/mesh"), root.find("asset/texture")
        if mesh is None or texture is None:
            raise ConfigError(f"LIBERO's object '{folder / self.name}.xml' has no mesh or no texture.")
        visual, image = folder / mesh.attrib["file"], folder / texture.attrib["file"]
        is_seen = visual.is_file() and image.is_file()
        boxes = tuple(
            GeomCfg(
                shape="box",
                size=_numbers(geom.attrib["size"]),
                pos=_triple(_numbers(geom.attrib["pos"])),
                rot=_quat(np.array(_numbers(geom.attrib["quat"]))),
                rgba=self.parts[0].rgba,
                mass_kg=8.0 * math.prod(_numbers(geom.attrib["size"])) * DENSITY,
                friction=FRICTION,
                visible=not is_seen,
            )
            for geom in root.iter("geom")
            if geom.attrib["type"] == "box"
        )
        if not is_seen:
            return boxes
        drawn = GeomCfg(
            shape="mesh",
            size=_numbers(mesh.attrib["scale"]),
            mesh=str(visual),
            texture=str(image),
            rgba=(1.0, 1.0, 1.0, 1.0),
            collides=False,
        )
        return (*boxes, drawn)

    def config(self, libero: Path | None) -> ObjectCfg:
        """Returns the object, of primitives or of LIBERO's files, at rest at the world's origin."""
        geoms = self.primitives() if libero is None else self.scanned(libero)
        return ObjectCfg(
            name=self.name, geoms=geoms, rot=self.rest_rot, pos=(0.0, 0.0, rest_height(geoms, self.rest_rot))
        )


def rest_height(geoms: tuple[GeomCfg, ...], rot: Quat) -> float:
    """Returns the height of a body's origin over the ground that its lowest corner touches, m.

    Args:
        geoms: Boxes, and cylinders whose axis is vertical; what does not collide does not count.
        rot: The body's orientation.
    """
    turn, lowest = np.array(rot), []
    for geom in geoms:
        if geom.collides:
            half = np.array(geom.size if geom.shape == "box" else (0.0, 0.0, geom.size[1]))
            axes = to_matrix(multiply(turn, np.array(geom.rot)))
            lowest.append(rotate(turn, np.array(geom.pos))[2] - np.abs(axes[2]) @ half)
    return float(-min(lowest))


def libero_root(folder: str) -> Path:
    """Returns the folder that has ``assets`` and ``init_files``, given it or a folder above it.

    Raises:
        ConfigError: if there is none.
    """
    start = Path(folder).expanduser()
    for inside in ("", "libero", "libero/libero"):
        if (start / inside / "assets" / "stable_hope_objects").is_dir():
            return start / inside
    raise ConfigError(
        f"libero_dir={folder} has no assets/stable_hope_objects. Give the folder of a copy of LIBERO "
        "(its root, or libero/libero inside it), or leave libero_dir out for objects made of primitives."
    )


def read_init_states(path: Path, width: int = INIT_WIDTH) -> np.ndarray:
    """Returns LIBERO's initial states of a task, (count, width) float64.

    A file ``.npz`` is LIBERO-PRO's, with the array ``states``; anything else is LIBERO's own:

    a zip with one pickled float64 array. Nothing is unpickled: its opcodes are listed, which
    runs none of them, and the array's bytes are the one long string among their arguments.

    Raises:
        ConfigError: if the file is absent or is anything else.
    """
    try:
        values = _states_of_numpy(path) if path.suffix == ".npz" else _states_of_torch(path)
    except FileNotFoundError:
        raise ConfigError(f"LIBERO's initial states are not there: no file {path}.") from None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ConfigError(
            f"{path} is not LIBERO's file of initial states: a zip with one array of {width} numbers "
            f"a row ({type(error).__name__}: {error})."
        ) from error
    if values.ndim != 2 or values.shape[1] != width:
        shape = " × ".join(map(str, values.shape))
        raise ConfigError(f"{path}: its initial states are {shape} numbers; rows of {width} fit the scene.")
    if not len(values) or not np.isfinite(values).all():
        raise ConfigError(f"{path} has no initial states, or some that are not finite.")
    return values


def _states_of_numpy(path: Path) -> np.ndarray:
    with np.load(path, allow_pickle=False) as archive:
        return np.asarray(archive["states"], dtype=np.float64)


def _states_of_torch(path: Path) -> np.ndarray:
    with zipfile.ZipFile(path) as archive:
        opcodes = pickletools.genops(io.BytesIO(archive.read("archive/data.pkl")))
        arguments = [argument for _, argument, _ in opcodes if isinstance(argument, str | int)]
    numbers = [argument for argument in arguments if isinstance(argument, int)]
    longest = max((argument for argument in arguments if isinstance(argument, str)), key=len)
    values = np.frombuffer(longest.encode("latin-1"), "<f8")
    shapes = [pair for pair in pairwise(numbers) if pair[0] * pair[1] == values.size]
    return values.reshape(shapes[0]) if shapes else values


def _parse(path: Path) -> ET.Element:
    try:
        return ET.parse(path).getroot()
    except FileNotFoundError:
        raise ConfigError(f"This copy of LIBERO lacks an object of the scene: no file {path}.") from None
    except ET.ParseError as error:
        raise ConfigError(f"LIBERO's file {path} cannot be read: {error}.") from error


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(word) for word in text.split())


def _triple(values) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _quat(values: np.ndarray) -> Quat:
    w, x, y, z = (float(value) for value in values / np.linalg.norm(values))
    return w, x, y, z


def _reach(part: Part) -> float:
    x, y = part.pos[:2]
    if part.shape == "box":
        return math.hypot(abs(x) + part.size[0], abs(y) + part.size[1])
    return math.hypot(x, y) + part.size[0]


def _volume(part: Part) -> float:
    if part.shape == "box":
        return 8.0 * math.prod(part.size)
    return 2.0 * math.pi * part.size[0] ** 2 * part.size[1]


# Sizes are the extents of LIBERO's collision boxes, in the orientation of rest; colours are those of the
# textures, by eye. The pudding, the sauce and the basket are LIBERO's boxes themselves.
GROCERIES = (
    Grocery(
        "chocolate_pudding",
        (0.0, 0.0, 0.0, 1.0),
        0.01019,
        (
            Part("box", (0.0401, 0.02316, 0.01371), (0.0005, 0.0, 0.00063), _CARDBOARD),
            # The light blue sides of the package and its title: seen only.
            Part("box", (0.0402, 0.0233, 0.0085), (0.0005, 0.0, 0.0), (0.45, 0.68, 0.86, 1.0), False),
            Part("box", (0.026, 0.008, 0.0138), (0.0005, 0.0, 0.00063), (0.93, 0.62, 0.35, 1.0), False),
        ),
    ),
    Grocery(
        "basket",
        _QUARTER,
        0.13611,
        (
            Part("box", (0.0724, 0.0766, 0.0085), (0.0, 0.0025, 0.0131), _WICKER),
            Part("box", (0.0724, 0.00667, 0.06368), (0.0, -0.0727, 0.0766), _WICKER),
            Part("box", (0.0724, 0.00667, 0.06368), (0.0, 0.0756, 0.0766), _WICKER),
            Part("box", (0.00667, 0.0724, 0.06368), (-0.0691, 0.0, 0.0818), _WICKER),
            Part("box", (0.00667, 0.0724, 0.06368), (0.0686, 0.0005, 0.0818), _WICKER),
        ),
        family="stable_scanned_objects",
    ),
    Grocery(
        "orange_juice",
        _Y_IS_UP,
        0.03167,
        (
            Part("box", (0.0263, 0.0263, 0.0548), (0.0, 0.0, -0.015), (0.93, 0.72, 0.12, 1.0)),
            Part("box", (0.015, 0.0263, 0.009), (0.0, 0.0, 0.0488), (0.90, 0.40, 0.06, 1.0)),
            Part("box", (0.003, 0.0263, 0.0045), (0.0, 0.0, 0.0622), (0.85, 0.82, 0.70, 1.0)),
        ),
    ),
    Grocery(
        "bbq_sauce",
        _QUARTER,
        0.01218,
        (
            Part("box", (0.0145, 0.0235, 0.0268), (0.0, 0.0, -0.0278), (0.25, 0.08, 0.02, 1.0)),
            Part("box", (0.0143, 0.0146, 0.0181), (0.0, 0.0, 0.0123), (0.25, 0.08, 0.02, 1.0)),
            Part("box", (0.0134, 0.0131, 0.0134), (0.0, 0.0, 0.0391), (0.72, 0.24, 0.05, 1.0)),
            Part("box", (0.0148, 0.016, 0.015), (0.0, 0.0, -0.03), (0.80, 0.66, 0.10, 1.0), False),
        ),
    ),
    Grocery(
        "ketchup",
        _Y_IS_UP,
        0.02322,
        (
            Part("box", (0.017, 0.0281, 0.0331), (0.0, 0.0, -0.0393), (0.75, 0.16, 0.03, 1.0)),
            Part("box", (0.017, 0.0215, 0.0212), (0.0, 0.0, 0.0150), (0.75, 0.16, 0.03, 1.0)),
            Part("cylinder", (0.0168, 0.0185), (0.0, 0.0, 0.0547), (0.80, 0.80, 0.78, 1.0)),
            Part("box", (0.0173, 0.0195, 0.022), (0.0, 0.0, -0.036), (0.86, 0.80, 0.62, 1.0), False),
        ),
    ),
    Grocery(
        "salad_dressing",
        _Y_IS_UP,
        0.02178,
        (
            Part("box", (0.0173, 0.0264, 0.031), (0.0, 0.0, -0.0417), (0.78, 0.78, 0.75, 1.0)),
            Part("box", (0.0149, 0.0195, 0.0233), (0.0, 0.0, 0.0126), (0.78, 0.78, 0.75, 1.0)),
            Part("cylinder", (0.0162, 0.0186), (0.0, 0.0, 0.0542), (0.05, 0.34, 0.14, 1.0)),
            Part("box", (0.0176, 0.0185, 0.022), (0.0, 0.0, -0.038), (0.22, 0.50, 0.16, 1.0), False),
        ),
    ),
    Grocery(
        "alphabet_soup",
        (0.0, 0.0, _S, _S),
        0.02585,
        (
            Part("cylinder", (0.0326, 0.0363), (0.0, 0.0, -0.0005), (0.12, 0.26, 0.58, 1.0)),
            Part("cylinder", (0.0329, 0.0140), (0.0, 0.0, -0.0215), (0.86, 0.45, 0.08, 1.0), False),
            Part("cylinder", (0.0315, 0.0381), (0.0, 0.0, -0.0005), (0.66, 0.66, 0.68, 1.0)),
        ),
    ),
)
"""All seven objects of the scene, in the order of LIBERO's initial states."""

"""Colours of real materials (sRGB), and how a field of tones becomes an image."""

import functools

import numpy as np

from envs.randomization.procedural.noise import Field, Stream

Color = np.ndarray  # (3,) float32, sRGB in [0, 255]

WOODS: dict[str, tuple[str, str, str]] = {
    # dark grain, middle, light
    "oak": ("8a6238", "b98a54", "d6b07c"),
    "white oak": ("a58a66", "c9b08a", "e0cdab"),
    "walnut": ("3a2518", "5c3d28", "7d573b"),
    "cherry": ("7a3f22", "a5603a", "c58558"),
    "maple": ("c09a68", "dcbf92", "ecd8b4"),
    "pine": ("b9803f", "dcae6c", "efcf98"),
    "birch": ("c8ab82", "e2cba6", "f0dfc2"),
    "ash": ("a08a6c", "cdb894", "e4d5b8"),
    "beech": ("b07f54", "d0a47a", "e2c09c"),
    "teak": ("6f4522", "9a6a38", "bd8f56"),
    "mahogany": ("4d1f12", "7a3720", "a05537"),
    "wenge": ("1d1410", "35261d", "4e3a2c"),
    "rosewood": ("32130d", "5d2a1c", "874634"),
    "grey wash": ("7d7870", "a39d93", "c4beb3"),
    "white wash": ("b8b2a6", "d8d3c8", "ece9e1"),
    "driftwood": ("6a5f53", "948778", "b8ad9d"),
    "ebony stain": ("141313", "262322", "3b3734"),
}

MARBLES: dict[str, tuple[str, str, str]] = {
    # ground, cloud, vein
    "carrara": ("eceae6", "d3d3d2", "8d9196"),
    "calacatta": ("f3efe6", "dfd6c4", "a08a62"),
    "nero marquina": ("17171a", "26262a", "d9d6cf"),
    "verde alpi": ("1f3a30", "37594a", "b9cdb9"),
    "emperador": ("4a3224", "6b4c38", "c9ad8c"),
    "rosso": ("6e2a22", "92463a", "dcc0b0"),
    "crema": ("e6d6b8", "d3bc94", "b0895a"),
    "bardiglio": ("7c8288", "5f666d", "c9ccce"),
    "rosa": ("e0bdae", "cf9f8c", "9d6a5c"),
    "azul": ("8aa0ad", "6a8596", "e4ddcf"),
    "onyx": ("e0b26a", "c48a3e", "f5e6c4"),
    "statuario": ("f4f4f3", "e3e4e5", "6b7077"),
}

GRANITES: dict[str, tuple[str, ...]] = {
    "black galaxy": ("121214", "1e1e21", "2c2c30", "6f6a5c"),
    "baltic brown": ("2a1d17", "5b3d2c", "8a6348", "b59175"),
    "kashmir white": ("e0dbd1", "c4bcb0", "8f877d", "5b3030"),
    "blue pearl": ("26303b", "3d4c5b", "64788a", "9fb2c0"),
    "ubatuba": ("1a211c", "2a352d", "48543f", "7f8264"),
    "santa cecilia": ("d7bd8e", "b4905c", "6a4c33", "2d2421"),
    "rosa porrino": ("c49a8c", "a87768", "e0c9be", "3a3231"),
    "steel grey": ("55585c", "6e7276", "8b8f93", "2b2d30"),
    "imperial red": ("5f1d1a", "84302a", "a8564a", "211414"),
    "bianco sardo": ("d2d0cc", "b5b2ae", "7c7a78", "3c3b3b"),
}

STONES = ("8f8a80", "a59c8d", "76736e", "b8a88e", "6a6f73", "9c8268", "c2b8a6", "585a5c", "a77f63", "88927f")
CONCRETES = ("a8a5a0", "8f8e8b", "bdb9b2", "77787a", "c9c4ba", "9b948a", "6a6a6b", "aeb1b2")
PAINTS = (
    "efece4", "e3ddcf", "d8e0dc", "c9d6df", "e8d8c8", "b7c4b1", "d9b9a0", "8fa3a8", "e6c9c2", "c7b8d0",
    "6f7f72", "a6453a", "3e5568", "ddc37c", "4f4a48", "f2e3b3", "9db3a0", "c4846a", "b4b7ba", "5f7f9b",
)  # fmt: skip
TEXTILES = (
    "ece7dc", "d2c6b0", "8c8273", "4a4743", "23262b", "243a5e", "3f6a8f", "8fb0c4", "7a2026", "b4463c",
    "d98a6a", "d4a93c", "e8d9a0", "2f4d36", "6d8a5f", "a9b89a", "5a3a5c", "a07aa0", "c9a7ab", "6b4a33",
    "b58a5e", "1f5b5f", "5fa09c", "9a9a9a",
)  # fmt: skip
BRICKS: dict[str, tuple[str, ...]] = {
    "red": ("8a3b28", "a04a33", "7a3022", "b15a40"),
    "london": ("b59a6a", "a3865a", "c4ab7e", "8b7350"),
    "brown": ("5a3d2e", "6e4b38", "4b3227", "80593f"),
    "white painted": ("e6e3dd", "dedad3", "eeece7", "d4d0c8"),
    "grey": ("7d7b78", "8f8c88", "6a6866", "a09d99"),
    "orange": ("b5633a", "c67548", "a3532f", "d28a5a"),
    "flemish": ("6e2f28", "8f4636", "54312d", "a3624c"),
    "black": ("2b2a2b", "38363a", "222122", "474448"),
    "sand": ("cdb591", "bfa27a", "dcc7a6", "b19268"),
    "pink": ("c08a7a", "b07868", "cf9f90", "a56a5c"),
}
CERAMICS = (
    "f2f0ea", "e4e1d8", "c9ccca", "8f979b", "4c5459", "22262a", "b9d0d3", "6fa0a8", "2f6272", "9fbfa4",
    "4d7a62", "e2cfae", "c79a6b", "a3552f", "7c2f2a", "d9b3a8", "35507a", "dfb64a",
)  # fmt: skip
METALS = ("b4b7ba", "8d9195", "6e7276", "c9c7c2", "9a8a72", "b08d57", "a5673f", "4a4d50", "d6d4d0", "7f8a94")
LEATHERS = (
    "3b2318",
    "5d3621",
    "7c4a2a",
    "a06a3e",
    "1c1a1a",
    "4a1718",
    "22303f",
    "d8c7a8",
    "6f6a62",
    "35402f",
)
GROUTS = ("d8d4ca", "bdb8ae", "9a968e", "6e6b67", "3d3c3b", "ece9e2")


@functools.lru_cache(maxsize=512)
def color(code: str) -> Color:
    """Returns the colour of a hexadecimal code, ``"rrggbb"``."""
    rgb = np.array([int(code[i : i + 2], 16) for i in (0, 2, 4)], dtype=np.float32)
    rgb.setflags(write=False)
    return rgb


def tinted(stream: Stream, code: str, amount: float = 12.0) -> Color:
    """Returns a colour near ``code``: lighter or darker, warmer or cooler.

    Args:
        stream: Source of the change.
        code: Hexadecimal code.
        amount: Largest change of brightness, of 255; a third of it may fall on the hue.
    """
    change = stream.array(-amount / 3, amount / 3, 3) + np.float32(stream.uniform(-amount, amount))
    return np.clip(color(code) + change, 4.0, 250.0)


def blend(colors: list[Color], steps: int = 512) -> np.ndarray:
    """Returns a (steps, 3) ramp through ``colors``, evenly spaced."""
    stops = np.stack(colors)
    x = np.arange(steps, dtype=np.float32) * np.float32((len(colors) - 1) / (steps - 1))
    low = np.minimum(np.floor(x).astype(np.int32), len(colors) - 2)
    t = (x - low.astype(np.float32))[:, None]
    return stops[low] * (np.float32(1.0) - t) + stops[low + 1] * t


def paint(ramp: np.ndarray, tone: Field) -> np.ndarray:
    """Returns (size, size, 3): the ramp's colour of each tone, 0 being its first and 1 its last."""
    index = np.clip(tone * np.float32(len(ramp)), 0, len(ramp) - 1).astype(np.int32)
    return np.take(ramp, index, axis=0)


def mix(below: np.ndarray, above: np.ndarray, mask: Field) -> np.ndarray:
    """Lays ``above`` over ``below`` where ``mask`` is 1; either may be a single colour."""
    m = mask[:, :, None]
    return below + (above - below) * m


def shade(rgb: np.ndarray, factor: Field) -> np.ndarray:
    """Multiplies every pixel's brightness by ``factor``."""
    return rgb * factor[:, :, None]

"""The frozen 90/10 splits: which episodes, materials and camera poses are for training, which for testing.

A split file never changes once results name it: ``splits/v2.json`` holds the lists themselves and a
SHA-256 over them, checked on every load. Another pool, library or grid is another file, ``v3.json``.
``python -m envs.randomization.splits`` samples the lists again and compares them with the file.

The last 1,000 episodes of the train split are also the **validation** split: a recipe is chosen by them,
without a look at the test split. Demonstrations are of the first episodes, so these starts and draws are new
to what learned from them; the materials, camera poses and words that they draw are those of training.

Light and reflection are sampled from continuous ranges by the episode's index. As no episode is in both
splits, 90 % of the samples are for training, and no sample of the test split occurs in training.
"""

import functools
import hashlib
import json
import logging
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from envs.core.arguments import run_program
from envs.core.atomic import write_file
from envs.core.errors import ConfigError, unknown_name
from envs.randomization import procedural
from envs.randomization.camera_poses import CAMERA_POSES
from envs.randomization.furniture_catalogue import LAYOUTS, PIECES
from envs.randomization.materials import MaterialLibrary
from envs.randomization.procedural.noise import Stream
from envs.scenario import SURFACES

logger = logging.getLogger(__name__)

SPLITS = ("train", "test")
"""The two sides of the frozen split."""

VALIDATION = "validation"
NUM_VALIDATION = 1_000
"""Episodes of the validation split: as many as the test split has."""

SPLIT_NAMES = ("train", VALIDATION, "test")

POOL_SIZE = 10_000
_FIRST_VERSION = "v1"
"""Seeds the lists of every version, so that what both have stays on its side."""

VERSION = "v2"
FOLDER = Path(__file__).parent / "splits"


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """One side of a frozen split, or the part of one that is for validation.

    Attributes:
        name: One of :data:`SPLIT_NAMES`.
        version: Version of the split file.
        digest: SHA-256 of the split file's content.
        episodes: Indices in the pool of episodes, sorted, read-only (num_episodes,) int64.
        materials: Surface to the names of its materials.
        cameras: Names of camera poses.
        furniture: Names of pieces of furniture.
        layouts: Names of layouts of furniture.
    """

    name: str
    version: str
    digest: str
    episodes: np.ndarray
    materials: Mapping[str, tuple[str, ...]]
    cameras: tuple[str, ...]
    furniture: tuple[str, ...]
    layouts: tuple[str, ...]

    def __contains__(self, episode: int) -> bool:
        at = int(np.searchsorted(self.episodes, episode))
        return at < len(self.episodes) and int(self.episodes[at]) == episode

    @property
    def drawn(self) -> "Split":
        """What its episodes draw from: itself, or the train split for validation."""
        return replace(self, name="train") if self.name == VALIDATION else self


def load_split(name: str, library: MaterialLibrary | None = None, *, version: str = VERSION) -> Split:
    """Loads one side of a frozen split.

    Args:
        name: One of :data:`SPLIT_NAMES`; there is no way to have both sides.
        library: Materials. A folder's images are not in the file and go to one side by a hash of
            their names.
        version: Version of the split file.

    Raises:
        UnknownNameError: if there is no such split or version.
        ConfigError: if the file is damaged, or a folder has too few images to be split.
    """
    if name not in SPLIT_NAMES:
        raise unknown_name("split", str(name), SPLIT_NAMES, "Name the split that is meant.")
    if name == VALIDATION:
        train = load_split("train", library, version=version)
        return replace(train, name=VALIDATION, episodes=train.episodes[-NUM_VALIDATION:])
    content = _load_content(version)
    test = np.array(content["test_episodes"], dtype=np.int64)
    episodes = test if name == "test" else np.setdiff1d(np.arange(content["pool"], dtype=np.int64), test)
    episodes.setflags(write=False)
    materials = {surface: tuple(content["materials"][surface][name]) for surface in SURFACES}
    if library is not None:
        materials = {surface: _of_library(library, surface, materials[surface], name) for surface in SURFACES}
    return Split(
        name=name,
        version=version,
        digest=content["sha256"],
        episodes=episodes,
        materials=MappingProxyType(materials),
        cameras=tuple(content["cameras"][name]),
        furniture=tuple(content["furniture"][name]),
        layouts=tuple(content["layouts"][name]),
    )


def episodes_before_validation() -> np.ndarray:
    """Returns the episodes of the train split that are not of the validation split, (num_episodes,) int64."""
    return load_split("train").episodes[:-NUM_VALIDATION]


def _of_library(
    library: MaterialLibrary, surface: str, frozen: tuple[str, ...], split: str
) -> tuple[str, ...]:
    """Returns a library's materials for one surface and split."""
    names = frozenset(library.names[surface])
    images = [name for name in library.names[surface] if library.is_image(name)]
    kept = tuple(name for name in frozen if name in names)
    return (*kept, *split_by_hash(images)[split]) if images else kept


def split_by_hash(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Divides images 90/10 by a hash of each one's file name, so that adding one never moves another.

    Only when a side would be empty, the name whose hash is nearest to the threshold changes sides.

    Raises:
        ConfigError: if there are fewer than two names.
    """
    if len(names) < 2:
        raise ConfigError(
            f"A folder of materials needs at least 2 images for each surface, one for training and one "
            f"for testing; given {len(names)}: {', '.join(names)}. Add images, or extend the built-in "
            f"materials."
        )
    rank = {name: hashlib.sha256(f"material {Path(name).name}".encode()).hexdigest() for name in names}
    num_test = sum(int(digits[:8], 16) < 2**32 // 10 for digits in rank.values())
    num_test = min(max(num_test, 1), len(names) - 1)
    test = set(sorted(names, key=lambda name: (rank[name], name))[:num_test])
    return {
        "train": tuple(name for name in names if name not in test),
        "test": tuple(name for name in names if name in test),
    }


def draw_content() -> dict[str, Any]:
    """Draws the lists of :data:`VERSION` from nothing but names.

    One of every ten neighbours is for testing, so that every family of materials, the frontal and the
    side views, and every part of the pool have their share.
    """

    def divide(label: str, items: Sequence[Any]) -> dict[str, list[Any]]:
        stream = Stream("split", _FIRST_VERSION, label)
        tens = range(0, len(items), 10)
        test = {start + stream.integer(0, min(10, len(items) - start) - 1) for start in tens}
        return {
            "train": [item for i, item in enumerate(items) if i not in test],
            "test": [item for i, item in enumerate(items) if i in test],
        }

    content: dict[str, Any] = {
        "version": VERSION,
        "textures": procedural.VERSION,
        "pool": POOL_SIZE,
        "test_episodes": divide("episodes", range(POOL_SIZE))["test"],
        "cameras": divide("cameras", list(CAMERA_POSES)),
        "furniture": divide("furniture", PIECES),
        "layouts": divide("layouts", LAYOUTS),
        "materials": {
            surface: divide(surface, procedural.surface_names(i)) for i, surface in enumerate(SURFACES)
        },
    }
    return content | {"sha256": content_digest(content)}


def content_digest(content: Mapping[str, Any]) -> str:
    """Returns the SHA-256 of a split's content: canonical JSON, without the digest itself."""
    body = {key: value for key, value in content.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(body, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


@functools.lru_cache(maxsize=4)
def _load_content(version: str) -> dict[str, Any]:
    versions = sorted(path.stem for path in FOLDER.glob("v*.json"))
    if version not in versions:
        raise unknown_name("split version", version, versions)
    return read_content(FOLDER / f"{version}.json")


def read_content(path: Path) -> dict[str, Any]:
    """Reads a split file and checks its digest.

    Raises:
        ConfigError: if the file is no split file or its content is not what was frozen.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"The split file '{path}' cannot be read ({error}). {_RESTORE}") from error
    stated = content.get("sha256") if isinstance(content, dict) else None
    found = content_digest(content) if isinstance(content, dict) else None
    if stated != found or stated is None:
        raise ConfigError(
            f"The split file '{path}' was changed: its content has SHA-256 {found}, it says {stated}. "
            f"A frozen split never changes, or results of before and after could not be compared. {_RESTORE}"
        )
    return content


_RESTORE = (
    "Restore the file (git checkout, or install the package again). For other lists, add a new version "
    "beside it."
)


def render_content(content: Mapping[str, Any]) -> str:
    """Returns a split file's text: one line for each list, so that a difference is legible."""
    lines = []
    for key, value in content.items():
        if key == "materials":
            inner = [f'    "{s}": {{\n{_sides(v, 6)}\n    }}' for s, v in value.items()]
            lines.append('  "materials": {\n' + ",\n".join(inner) + "\n  }")
        elif key in ("cameras", "furniture", "layouts"):
            lines.append(f'  "{key}": {{\n{_sides(value, 4)}\n  }}')
        else:
            lines.append(f'  "{key}": {json.dumps(value)}')
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _sides(sides: Mapping[str, list[str]], indent: int) -> str:
    return ",\n".join(f'{" " * indent}"{side}": {json.dumps(items)}' for side, items in sides.items())


def freeze(path: Path) -> bool:
    """Writes the split file, or checks that the existing one has the lists sampled now.

    Returns:
        True where the file was written, False where it was there and is right.

    Raises:
        ConfigError: if the file exists and has other lists.
    """
    content = draw_content()
    if path.exists():
        if read_content(path) != content:
            raise ConfigError(
                f"The split file '{path}' is frozen, and the lists sampled now differ from it: the pool, the "
                f"materials or the cameras have changed. Give VERSION in envs/randomization/splits.py the "
                f"next number; the new lists then become a file of their own."
            )
        return False
    write_file(path, render_content(content).encode())
    return True


@dataclass(frozen=True, kw_only=True, slots=True)
class FreezeSettings:
    """Settings of the program.

    Attributes:
        path: The split file.
    """

    path: Path = FOLDER / f"{VERSION}.json"


def main(words: Sequence[str] | None = None) -> int:
    """Freezes or checks the split of :data:`VERSION`; returns the exit code."""
    return run_program("python -m envs.randomization.splits", FreezeSettings, _freeze, words)


def _freeze(settings: FreezeSettings) -> None:
    written = freeze(settings.path)
    logger.info(
        "%s: %s", settings.path, "written" if written else "unchanged, its lists and digest are right"
    )


if __name__ == "__main__":
    sys.exit(main())

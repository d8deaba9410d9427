"""The groceries of a set as objects of a scene, and where they may stand."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from envs.core.errors import MissingExtraError
from envs.core.extras import install_command
from envs.kinematics.object_parts import ObjectParts, parts_of
from envs.mjcf.imported import imported
from envs.scenario import ObjectCfg
from envs.state import EntityState
from envs.tasks.grasp_language.catalogue import EXTRA, groceries, in_scene
from envs.tasks.libero.scene import OBJECT_FACES, asset_of
from envs.tasks.skills.clouds import cloud

_TRIES, _ROUNDS = 200, 100


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """An object of the scene.

    Attributes:
        cfg: The object, standing at the origin.
        parts: Its parts and collision boxes.
        height_m: Height of its origin where it stands.
        radius_m: Radius of the circle round its origin that holds its outline, seen from above.
    """

    cfg: ObjectCfg
    parts: ObjectParts
    height_m: float
    radius_m: float


@lru_cache(maxsize=8)
def objects_of(set_name: str) -> dict[str, Placed]:
    """Returns the objects of a set's scene by name.

    Raises:
        MissingExtraError: The extra ``libero`` is not installed.
    """
    return {name: _placed(name) for name in in_scene(set_name)}


@lru_cache(maxsize=64)
def _placed(name: str) -> Placed:
    item = groceries()[name]
    source = asset_of(item.asset)
    if source is None:
        raise MissingExtraError(
            f"The installed packages of the extra '{EXTRA}' have no '{item.asset}'. "
            f"Install those of its versions: {install_command(EXTRA)}"
        )
    path = imported(source, max_faces=OBJECT_FACES, free=True, colour=item.colour)
    parts = parts_of(path)
    points = cloud(parts, EntityState.at_rest(np.zeros(3), np.array([item.rest])))
    height, radius = -float(points[:, 2].min()), float(np.linalg.norm(points[:, :2], axis=1).max())
    cfg = ObjectCfg(
        name=name,
        mjcf=str(path),
        mjcf_root="object",
        mjcf_shown=(1,),
        pos=(0.0, 0.0, height),
        rot=item.rest,
    )
    return Placed(cfg, parts, height, radius)


def draw_places(
    rng: np.random.Generator, radii: Sequence[float], half: tuple[float, float], gap_m: float
) -> np.ndarray:
    """Draws places (n, 2) in a rectangle so that circles of the radii keep a gap.

    Objects are put down one after the other, the largest first; where one finds no room, all begin again.
    Gaps shrink from round to round, so that it ends in any rectangle.

    Args:
        rng: The generator.
        radii: Of the circles, m.
        half: Half widths of the rectangle round the origin, x and y, m.
        gap_m: Least gap between two circles.
    """
    order = sorted(range(len(radii)), key=lambda index: -radii[index])
    places = np.zeros((len(radii), 2))
    for turn in range(_ROUNDS):
        scale = 1.0 - turn / _ROUNDS
        done: list[int] = []
        for index in order:
            need = scale * (np.array([radii[other] for other in done]) + radii[index] + gap_m)
            tries = rng.uniform(-1.0, 1.0, (_TRIES, 2)) * half
            free = (np.linalg.norm(tries[:, None] - places[done], axis=-1) >= need).all(axis=1)
            if not free.any():
                break
            places[index] = tries[int(free.argmax())]
            done.append(index)
        if len(done) == len(order):
            return places
    return places

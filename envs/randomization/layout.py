"""The channel ``layout``: objects that have no part in the task stand on the table.

Two or three of them stand where neither the task's objects nor the hand on the expert's way come near, and as
near the task as that allows. They collide, and nothing moves them, so the task's own physics is as without
them. Every tenth object of the catalogue is held out for the test split.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, override

import numpy as np

from envs.core.errors import ConfigError
from envs.randomization.channels import Channel, Scene, Workspace, divided
from envs.randomization.distractors import CATALOGUE, HEIGHT_M, Distractor, distractor, object_name
from envs.rotations import from_yaw

if TYPE_CHECKING:
    from envs.randomization.splits import Split
    from envs.scenario import ScenarioCfg
    from envs.state import State

NUM_SHOWN = (2, 3)
"""Least and largest number of distractors in an episode."""

CANDIDATES = 200
"""Places that are drawn for each; it stands at the first that is free, and is left out where none is."""

FROM_OBJECTS_M = 0.03
"""Least distance from every box round a geom of the task's objects."""

FROM_HAND_M = 0.13
"""Least distance from where the hand goes, seen from above: a Panda's hand, 0.2 m wide, and 3 cm more."""

FROM_EACH_OTHER_M = 0.02

BELOW_HAND_M = 0.10
"""A hand that is so much higher than a distractor passes above it, with what it carries."""

AROUND_M = 0.2
"""How far from the task's objects and ways distractors may stand."""

EDGE_M = 0.03
"""Least distance from an edge of what it stands on."""

FLAT_M = 0.002
"""Heights that differ by less are one plane."""

_RIM = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
"""Points below a distractor where its support is looked for, in radii."""

PARKED_M = 1.0
"""How far below the ground distractors are that an episode does not show."""


@dataclass(frozen=True, slots=True)
class ShownDistractor:
    """One distractor of an episode.

    Attributes:
        name: Its name in the catalogue.
        seed: Seeds its candidate places.
    """

    name: str
    seed: int

    def places(self) -> np.ndarray:
        """Returns candidates: shares (x, y) of the region, and turn about z, rad, (CANDIDATES, 3)."""
        shares = np.random.default_rng(np.random.SeedSequence(self.seed)).uniform(0.0, 1.0, (CANDIDATES, 3))
        return np.round(shares * (1.0, 1.0, 2.0 * np.pi), 6)


class LayoutChannel(Channel):
    """Stands distractors on the table."""

    @override
    def split(self, scene: Scene) -> tuple[str, ...]:
        return divided(CATALOGUE, scene.split.name)

    @override
    def sample(
        self, rng: np.random.Generator, allowed: tuple[str, ...], scene: Scene
    ) -> tuple[ShownDistractor, ...]:
        count = int(rng.integers(NUM_SHOWN[0], NUM_SHOWN[1] + 1))
        chosen = rng.permutation(len(allowed))[:count]
        seeds = rng.integers(2**32, size=count)
        return tuple(
            ShownDistractor(allowed[index], int(seed)) for index, seed in zip(chosen, seeds, strict=True)
        )

    @override
    def start(self, state: "State", draw: tuple[ShownDistractor, ...], scene: Scene) -> "State":
        from envs.state import EntityState

        workspace, scenario = scene.workspace, scene.scenario
        assert workspace is not None and scenario is not None, "whoever starts episodes gives both"
        own = replace(state, objects={k: v for k, v in state.objects.items() if not _is_distractor(k)})
        placed = _placed(own, draw, scene, workspace)
        below, objects = scenario.floor_z - PARKED_M, dict(own.objects)
        for number, name in enumerate(self.split(scene)):
            x, y, z, yaw = placed.get(name, (0.2 * number, 0.0, below, 0.0))
            pose = EntityState.at_rest(np.array([x, y, z]), from_yaw(np.array([yaw])))
            objects[object_name(name)] = pose
        return replace(own, objects=objects)

    @override
    def scenario(self, scenario: "ScenarioCfg", split: "Split") -> "ScenarioCfg":
        if not scenario.objects or not scenario.robots or not scenario.robots[0].fixed_base:
            raise ConfigError(
                "The channel 'layout' stands objects beside those of a task that an arm does, and this task "
                "has none, or no arm that is bolted down. Vary another channel, such as only=sensor."
            )
        names = divided(CATALOGUE, split.name)
        return replace(
            scenario, objects=(*scenario.objects, *(distractor(name).as_object() for name in names))
        )


def _is_distractor(name: str) -> bool:
    return name.startswith(object_name(""))


def _placed(
    state: "State", draw: Sequence[ShownDistractor], scene: Scene, workspace: Workspace
) -> dict[str, tuple[float, float, float, float]]:
    """Returns position, m, and turn about z, rad, of each distractor that has a free place."""
    way = workspace.way(state, scene.rng("layout/way"))
    z = _support(workspace, state, way)
    if z is None:
        return {}
    boxes = workspace.boxes(state)
    boxes = boxes[boxes[:, 1, 2] > z + FLAT_M]  # what lies in the plane is stood on
    low = np.minimum(boxes[:, 0, :2].min(0), way[:, :2].min(0)) - AROUND_M
    high = np.maximum(boxes[:, 1, :2].max(0), way[:, :2].max(0)) + AROUND_M
    near = way[way[:, 2] < z + HEIGHT_M + BELOW_HAND_M, :2]
    room = _Room(boxes, np.concatenate([near, np.array(workspace.robot.pos[:2])[None]]), [])
    standing: dict[str, tuple[float, float, float, float]] = {}
    for item in draw:
        own = distractor(item.name)
        rim = (own.radius_m + EDGE_M) * _RIM
        for share_x, share_y, yaw in item.places():
            at = np.round(low + np.array([share_x, share_y]) * (high - low), 6)
            if room.is_free(at, own) and (np.abs(workspace.heights(state, at + rim) - z) < FLAT_M).all():
                standing[item.name] = (float(at[0]), float(at[1]), z, float(yaw))
                room.taken.append((at, own.radius_m))
                break
    return standing


def _support(workspace: Workspace, state: "State", way: np.ndarray) -> float | None:
    """Returns the height of what is below the hand on most of its way, m; None where that is nothing."""
    around = (way[::4, None, :2] + 0.1 * _RIM).reshape(-1, 2)
    heights = workspace.heights(state, around)
    found, counts = np.unique(np.round(heights[~np.isnan(heights)], 4), return_counts=True)
    return float(found[counts.argmax()]) if len(found) else None


@dataclass(frozen=True, slots=True)
class _Room:
    """What distractors stay away from: boxes (B, 2, 3), points of a way (P, 2), other distractors."""

    boxes: np.ndarray
    way: np.ndarray
    taken: list[tuple[np.ndarray, float]]

    def is_free(self, at: np.ndarray, own: Distractor) -> bool:
        low, high = self.boxes[:, 0, :2], self.boxes[:, 1, :2]
        outside = np.maximum(np.maximum(low - at, at - high), 0.0)
        return bool(
            (np.linalg.norm(outside, axis=-1) > own.radius_m + FROM_OBJECTS_M).all()
            and (np.linalg.norm(self.way - at, axis=-1) > own.radius_m + FROM_HAND_M).all()
            and all(
                np.linalg.norm(at - other) > own.radius_m + radius + FROM_EACH_OTHER_M
                for other, radius in self.taken
            )
        )

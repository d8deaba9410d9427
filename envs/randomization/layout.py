"""The channel ``layout``: objects that have no part in the task stand on the table.

Two or three of them stand where neither the task's objects nor the hand on the expert's way come near, and as near
the task as that allows. They collide, and nothing moves them, so the task's own physics is as without them. Every
tenth object of the catalogue is held out for the test split.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, override

import numpy as np

from envs.randomization.channels import Channel, Scene, Workspace, divided
from envs.randomization.distractors import CATALOGUE, HEIGHT_M, Distractor, distractor, object_name
from envs.rotations import from_yaw

if TYPE_CHECKING:
    from envs.randomization.splits import Split
    from envs.scenario import ScenarioCfg
    from envs.state import State

NUM_SHOWN = (2, 3)
"""Least and largest number of distractors in an episode."""

CANDIDATES = 60
"""Places that are drawn for each; it stands at the first that is free, and is left out where none is."""

FROM_OBJECTS_M = 0.05
"""Least distance from every box round a geom of the task's objects."""

FROM_HAND_M = 0.13
"""Least distance from where the hand goes, seen from above: a Panda's hand, 0.2 m wide, and 3 cm more."""

FROM_EACH_OTHER_M = 0.02

BELOW_HAND_M = 0.10
"""The hand passes above a distractor without coming near it if it, with what it carries, is so much higher."""

AROUND_M = 0.25
"""How far from the task's objects and ways distractors may stand."""

EDGE_M = 0.05
"""Least distance from the table's edge."""

PARKED_M = 1.0
"""How far below the ground distractors are that an episode does not show."""


@dataclass(frozen=True, slots=True)
class Candidates:
    """One distractor and its candidate places.

    Attributes:
        name: Its name in the catalogue.
        places: Shares (x, y) of the region, and turn about z, rad, of each candidate.
    """

    name: str
    places: tuple[tuple[float, float, float], ...]


class LayoutChannel(Channel):
    """Stands distractors on the table."""

    changes_starts: ClassVar[bool] = True

    @override
    def split(self, scene: Scene) -> tuple[str, ...]:
        return divided(CATALOGUE, scene.split.name)

    @override
    def sample(
        self, rng: np.random.Generator, allowed: tuple[str, ...], scene: Scene
    ) -> tuple[Candidates, ...]:
        count = int(rng.integers(NUM_SHOWN[0], NUM_SHOWN[1] + 1))
        chosen = rng.permutation(len(allowed))[:count]
        places = np.round(rng.uniform(0.0, 1.0, (count, CANDIDATES, 3)) * (1.0, 1.0, 2 * np.pi), 6)
        return tuple(
            Candidates(allowed[index], tuple((float(x), float(y), float(yaw)) for x, y, yaw in own))
            for index, own in zip(chosen, places, strict=True)
        )

    @override
    def start(self, state: "State", draw: tuple[Candidates, ...], scene: Scene) -> "State":
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
        names = divided(CATALOGUE, split.name)
        return replace(
            scenario, objects=(*scenario.objects, *(distractor(name).as_object() for name in names))
        )


def _is_distractor(name: str) -> bool:
    return name.startswith(object_name(""))


def _placed(
    state: "State", draw: Sequence[Candidates], scene: Scene, workspace: Workspace
) -> dict[str, tuple[float, float, float, float]]:
    """Returns position, m, and turn about z, rad, of each distractor that has a free place."""
    z = workspace.support_z_m
    boxes = workspace.boxes(state)
    boxes = boxes[boxes[:, 1, 2] > z + 0.002]  # what lies in the plane is stood on
    way = workspace.way(state, scene.rng("layout/way"))
    low = np.minimum(boxes[:, 0, :2].min(0), way[:, :2].min(0)) - AROUND_M
    high = np.maximum(boxes[:, 1, :2].max(0), way[:, :2].max(0)) + AROUND_M
    table = scene.scenario.table if scene.scenario is not None else None
    if table is not None:
        middle, half = np.array(table.pos[:2]), np.array(table.half_size) - EDGE_M
        low, high = np.maximum(low, middle - half), np.minimum(high, middle + half)
    near = way[way[:, 2] < z + HEIGHT_M + BELOW_HAND_M, :2]
    base = np.array(workspace.robot.pos[:2])[None]
    standing: dict[str, tuple[float, float, float, float]] = {}
    taken: list[tuple[np.ndarray, float]] = []
    for item in draw:
        own = distractor(item.name)
        for share_x, share_y, yaw in item.places:
            at = np.round(low + np.array([share_x, share_y]) * (high - low), 6)
            if _is_free(at, own, boxes, np.concatenate([near, base]), taken):
                standing[item.name] = (float(at[0]), float(at[1]), z, yaw)
                taken.append((at, own.radius_m))
                break
    return standing


def _is_free(
    at: np.ndarray,
    own: Distractor,
    boxes: np.ndarray,
    way: np.ndarray,
    taken: Sequence[tuple[np.ndarray, float]],
) -> bool:
    outside = np.maximum(np.maximum(boxes[:, 0, :2] - at, at - boxes[:, 1, :2]), 0.0)
    return bool(
        (np.linalg.norm(outside, axis=-1) > own.radius_m + FROM_OBJECTS_M).all()
        and (np.linalg.norm(way - at, axis=-1) > own.radius_m + FROM_HAND_M).all()
        and all(np.linalg.norm(at - other) > own.radius_m + r + FROM_EACH_OTHER_M for other, r in taken)
    )

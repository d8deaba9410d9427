"""PickPlace with all four objects, after robosuite 1.5.1 (``manipulation/pick_place.py``, MIT).

Its parts are the tasks of single objects, :mod:`envs.tasks.robosuite.pick_place`; the objects start in the
first bin without touching. The reward is robosuite's shaped one.
"""

from dataclasses import dataclass
from functools import cache
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import concatenate, largest, stack, where
from envs.kinematics.waypoints import Waypoint
from envs.scenario import CameraCfg, ObjectCfg, RobotCfg, TableCfg
from envs.state import State
from envs.tasks.arm_at_table import Start, point
from envs.tasks.robosuite.pick_place import (
    HOVER_REWARD,
    PickPlaceBread,
    PickPlaceCan,
    PickPlaceCereal,
    PickPlaceMilk,
    PickPlaceSingle,
)
from envs.tasks.robosuite.scene import RobosuiteTask
from envs.tasks.tabletop import ee_pos

SINGLES: tuple[type[PickPlaceSingle], ...] = (PickPlaceMilk, PickPlaceBread, PickPlaceCereal, PickPlaceCan)
"""In robosuite's order, in which their starts are drawn."""

_FINGERS_M = 0.055
"""Distance of an open finger's middle from the middle of the hand."""

_TRIES = 5000
"""Places after which a crowded bin is filled again, as robosuite's sampler gives up."""


@dataclass(frozen=True, kw_only=True)
class PickPlace(RobosuiteTask):
    """Put all four objects into their compartments."""

    name: ClassVar[str] = "PickPlace"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the milk, the bread, the cereal and the can each into its compartment",
        "sort all four objects from the light bin into the dark one",
        "move every object into its own compartment of the dark bin",
    )
    max_episode_steps: ClassVar[int] = 1200
    own_robot: ClassVar[RobotCfg] = PickPlaceSingle.own_robot
    table: ClassVar[TableCfg] = PickPlaceSingle.table
    camera: ClassVar[CameraCfg] = PickPlaceSingle.camera

    @property
    def singles(self) -> tuple[PickPlaceSingle, ...]:
        """The tasks of the single objects, with this one's robot."""
        return _singles(self.robot)

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        first, *others = self.singles
        item, *bins = first.objects
        return (item, *(other.objects[0] for other in others), *bins)

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        drawn: dict[str, Start] = {}
        for _ in range(_TRIES):
            task = self.singles[len(drawn)]
            (start,) = task.starts(rng).values()
            others = self.singles[: len(drawn)]
            if all(_apart(task, start, other, drawn[other.good.name]) for other in others):
                drawn[task.good.name] = start
            if len(drawn) == len(self.singles):
                return drawn
        return self.starts(rng)

    @override
    def success(self, state: State) -> Tensor:
        done = self.singles[0].success(state)
        for single in self.singles[1:]:
            done = done & single.success(state)
        return done

    @override
    def reward(self, state: State) -> Tensor:
        """Returns robosuite's: the objects in place, and the best stage of one that is not; over 4."""
        done = stack([single.success(state) for single in self.singles])
        stages = [single.reward(state) for single in self.singles]
        left = [where(done[index], 0.0, stage) for index, stage in enumerate(stages)]
        best = largest(stack(left).T)
        return (done.sum(0) + best) / (len(SINGLES) + HOVER_REWARD)

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the objects' poses, the hand and the ways to it, (N, 43)."""
        hand = ee_pos(self.arm(state))
        items = [state.objects[single.good.name] for single in self.singles]
        parts = [part for item in items for part in (item.pos, item.rot, item.pos - hand)]
        return concatenate((hand, *parts))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way of one object: of those that are not in place, the one with most room round it."""
        left = [single for single in self.singles if not bool(single.in_place(state)[0])]
        if not left:
            return self.rise(state, 0.25)
        return max(left, key=lambda single: _room(single, state, left)).expert(state, rng)


@cache
def _singles(robot: RobotCfg) -> tuple[PickPlaceSingle, ...]:
    return tuple(type(cls.__name__, (cls,), {"own_robot": robot})() for cls in SINGLES)


def _apart(task: PickPlaceSingle, start: Start, other: PickPlaceSingle, there: Start) -> bool:
    """Whether the circles of two objects do not overlap (``UniformRandomSampler``)."""
    gap = np.linalg.norm(np.array(start.pos[:2]) - np.array(there.pos[:2]))
    return bool(gap > task.good.radius_m + other.good.radius_m)


def _room(single: PickPlaceSingle, state: State, left: list[PickPlaceSingle]) -> float:
    """Returns how far the fingers that would grasp an object stay from the others, m."""
    pos, turn = point(state.objects[single.good.name])[:2], single.grasp_turn(state)
    side = _FINGERS_M * np.array([-np.sin(turn), np.cos(turn)])
    gaps = []
    for other in (item for item in left if item is not single):
        there = point(state.objects[other.good.name])[:2]
        fingers = [float(np.linalg.norm(pos + sign * side - there)) for sign in (-1.0, 1.0)]
        gaps.append(min(fingers) - other.good.radius_m)
    return min(gaps, default=1.0)

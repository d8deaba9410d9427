"""What a demonstration does to the objects, found from its states alone: neither contacts nor the gripper.

An object is *carried* while it moves with the hand; a part of an articulated object is *moved* while its
joint moves. A carried object belongs at the object nearest to it when it is put down.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roboverse_learn.data.augmentation.pose import Pose
from roboverse_learn.data.augmentation.recording import SourceDemo
from roboverse_learn.data.augmentation.references import References, in_frame

CARRIED_M_S = 0.02
"""Speed above which an object is carried."""

SLIP_SHARE, SLIP_M_S = 0.35, 0.03
"""A carried object moves in the hand's frame by less than this share of its own way, or than this speed."""

NEAR_HAND_M = 0.15
MOVED_PER_S = 0.04
"""Speed of a part's joint above which it is moved, rad/s (m/s)."""

GAP_STEPS = 3
"""Pauses of this many control steps do not end a movement."""

NEAR_TARGET_M = 0.25
"""An object with no other one as near as this in the plane was carried to no object."""


@dataclass(frozen=True, slots=True)
class Movement:
    """One thing moved by the hand, over one or several stretches of steps.

    Attributes:
        moved: Object, or ``object/part``.
        target: Object that it was carried to; ``moved`` itself for none, and for a part.
        stretches: First step and one past the last of each stretch. An expert that misses grasps again.
    """

    moved: str
    target: str
    stretches: tuple[tuple[int, int], ...]

    @property
    def first(self) -> int:
        """Its first step."""
        return self.stretches[0][0]

    @property
    def last(self) -> int:
        """One past its last step."""
        return self.stretches[-1][1]

    def __str__(self) -> str:
        """Returns what is done, in words."""
        if "/" in self.moved:
            return f"{self.moved} moved"
        return f"{self.moved} carried" + (f" to {self.target}" if self.target != self.moved else "")


def stretches(mask: np.ndarray, least: int, gap: int = GAP_STEPS) -> list[tuple[int, int]]:
    """Returns first and one past the last index of each run of true values of at least ``least``.

    Args:
        mask: (T,) bool.
        least: Shorter runs are dropped.
        gap: Runs this far apart are one.
    """
    found: list[list[int]] = []
    for index in np.flatnonzero(mask).tolist():
        if found and index - found[-1][1] <= gap:
            found[-1][1] = index + 1
        else:
            found.append([index, index + 1])
    return [(first, end) for first, end in found if end - first >= least]


def movements(demo: SourceDemo, references: References, control_hz: float, least: int) -> list[Movement]:
    """Returns what a demonstration moves, in order; stretches of one thing in a row are one movement.

    Args:
        demo: The demonstration.
        references: The scene's objects and parts.
        control_hz: Control steps per second.
        least: Shortest stretch, in control steps.
    """
    found: list[tuple[int, int, str]] = []
    for name in references.movable:
        found += [(*run, name) for run in stretches(_carried(demo, references, name, control_hz), least)]
    for part, (item, column) in references.parts.items():
        joint = demo.states.objects[item].joint_pos[:, column].numpy()
        moving = np.abs(np.diff(joint)) * control_hz > MOVED_PER_S
        found += [(*run, part) for run in stretches(moving, least)]
    merged: list[tuple[str, list[tuple[int, int]]]] = []
    for first, end, name in sorted(found):
        if merged and merged[-1][0] == name:
            merged[-1][1].append((first, end))
        else:
            merged.append((name, [(first, end)]))
    return [
        Movement(name, _target(demo, references, name, runs[-1][1]), tuple(runs)) for name, runs in merged
    ]


def _carried(demo: SourceDemo, references: References, name: str, control_hz: float) -> np.ndarray:
    """Returns at which steps an object is carried, (T,) bool."""
    pos = references.pose(demo.states, name).pos
    hand: Pose = demo.hand
    inside = in_frame(hand, pos)
    moves, slips = (np.linalg.norm(np.diff(path, axis=0), axis=1) for path in (pos, inside))
    near = np.linalg.norm(pos - hand.pos, axis=1)[1:] < NEAR_HAND_M
    sticks = slips < np.maximum(SLIP_M_S / control_hz, SLIP_SHARE * moves)
    return (moves * control_hz > CARRIED_M_S) & sticks & near


def _target(demo: SourceDemo, references: References, moved: str, end: int) -> str:
    """Returns the object nearest in the plane to a carried one when its movement ends."""
    others: Sequence[str] = [name for name in references.objects if name != moved]
    if "/" in moved or not others:
        return moved
    place = references.pose(demo.states, moved).pos[end, :2]
    away = [float(np.linalg.norm(references.pose(demo.states, name).pos[end, :2] - place)) for name in others]
    nearest = int(np.argmin(away))
    return others[nearest] if away[nearest] < NEAR_TARGET_M else moved

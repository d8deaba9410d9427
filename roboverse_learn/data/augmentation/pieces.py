"""Cuts demonstrations into pieces: each a hand path relative to one object, with one skill.

A movement of a carried object is three pieces: *reach* it and, from where the gripper begins to close,
*grasp* it, both relative to the object; then *carry* it relative to its target. A moved part is two: reach
it, and move it. The cut where the skill changes is where a plan may be refined by where the object then is.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from envs.core.errors import DatasetError
from envs.tasks.segment import Segment
from roboverse_learn.data.augmentation.movements import Movement
from roboverse_learn.data.augmentation.pose import angle_rad, distance_m
from roboverse_learn.data.augmentation.recording import SourceDemo

LEAD_M, LEAD_CARRIED_M = 0.10, 0.13
"""The last part of a way to an object, and of a carried object to its target, which is kept as the source has
it: a peg of 10 cm is passed from above."""

ASIDE_M, NEAR_M = 0.03, 0.06
"""A carried object that comes from aside by more than the first keeps only the second of its way: it is not
put onto anything yet."""

LIFT_M = 0.05
"""The first part of the way of a carried object, likewise: it is lifted first."""

REACH_M = 0.4
"""Length of the way that is kept of a source before the last :data:`LEAD_M`: earlier its hand may wander."""

WAIT_STEPS = 8
"""Longest wait that is kept, in control steps: a gripper closes meanwhile."""

STILL_M, STILL_RAD = 5e-4, 5e-3
"""A hand that is commanded to move by less than this in a control step waits."""

CLEAR_M = 0.08
"""Distance of the hand from where it let go, from which on it may go to the next object."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Piece:
    """Some steps of a demonstration.

    Attributes:
        reference: Object or part that the hand moves relative to.
        carried: Object that the hand carries, or empty.
        subtask: Number of the movement that it belongs to, from 0.
        steps: The steps, ascending; those in which the hand wanders or waits are left out, (L,).
        anchor: State in which the reference is where the hand goes to.
        free: First and one past the last of ``steps`` in which the hand may leave the source's path; equal
            for a moment at which it may.
    """

    reference: str
    carried: str
    subtask: int
    steps: np.ndarray
    anchor: int
    free: tuple[int, int]

    @property
    def role(self) -> tuple[str, str, int]:
        """What the pieces of all sources at one place have in common."""
        return self.reference, self.carried, self.subtask

    @property
    def acts(self) -> bool:
        """Whether it begins at its contact, as a grasp does."""
        return not self.carried and self.free == (0, 0)


@dataclass(frozen=True, slots=True)
class _Span:
    """A subtask's steps relative to one reference.

    Attributes:
        contact: Step at which the object begins to move; for a carried one, at which it is let go.
    """

    reference: str
    carried: str
    subtask: int
    first: int
    last: int
    contact: int


def cut(demo: SourceDemo, found: Sequence[Movement], *, refine: bool) -> tuple[Piece, ...]:
    """Returns the pieces of a demonstration from what it moves.

    Args:
        demo: The demonstration.
        found: Its movements.
        refine: Cut where the gripper begins to close.
    """
    spans, begin = [], 0
    nexts = [movement.first for movement in found[1:]]
    for number, movement in enumerate(found):
        is_last = number == len(found) - 1
        if "/" in movement.moved:
            end = demo.num_steps if is_last else min(_clear(demo, movement.last), nexts[number] - 1)
            spans.append(_Span(movement.moved, "", number, begin, end, movement.first))
        else:
            lift, opened = _final_grasp(demo, movement)
            let_go = next((step for step in demo.gripper_changes if step > lift), movement.last)
            end = demo.num_steps if is_last else min(_clear(demo, let_go), nexts[number] - 1)
            spans.append(_Span(movement.moved, "", number, max(begin, opened), lift, lift))
            spans.append(_Span(movement.target, movement.moved, number, lift, end, min(let_go, end)))
        begin = end
    return tuple(piece for span in spans for piece in _pieces(demo, span, refine))


def cut_as_stated(demo: SourceDemo, segments: Sequence[Segment], *, refine: bool) -> tuple[Piece, ...]:
    """Returns the pieces of a demonstration by the segments that its task states.

    Raises:
        DatasetError: A segment does not end in it.
    """
    spans, begin, subtask = [], 0, 0
    for segment in segments:
        end = demo.num_steps
        if segment.until is not None:
            over = torch.nonzero(segment.until(demo.states)[begin + 1 :])
            if not len(over):
                raise DatasetError(f"its subtask at '{segment.reference}' never ends")
            end = begin + 1 + int(over[0, 0])
        changes = [step for step in demo.gripper_changes if begin < step < end]
        contact = end - 1
        if changes:
            contact = changes[0] if segment.carries else changes[-1]
        spans.append(_Span(segment.reference, segment.carries, subtask, begin, end, contact))
        subtask += bool(segment.carries)
        begin = end
        if begin >= demo.num_steps:
            break
    return tuple(piece for span in spans for piece in _pieces(demo, span, refine))


def sped_up(pieces: Sequence[Piece], most_steps: float) -> tuple[Piece, ...]:
    """Returns pieces whose steps outside the windows are about ``most_steps`` together, or the same pieces.

    A person may take a minute for what a task gives seconds. What a hand does at an object, such as
    closing, keeps its time; ways to and from there are played faster by one factor.
    """
    fixed = sum(len(piece.steps) for piece in pieces if piece.acts)
    slow = sum(len(piece.steps) - (piece.free[1] - piece.free[0]) for piece in pieces if not piece.acts)
    factor = slow / max(most_steps - fixed, 1.0)
    if factor <= 1.0:
        return tuple(pieces)
    return tuple(piece if piece.acts else _faster(piece, factor) for piece in pieces)


def _faster(piece: Piece, factor: float) -> Piece:
    """Returns a piece with every ``factor``-th of its steps, and the last."""
    rows = np.unique(np.round(np.append(np.arange(0, len(piece.steps) - 1, factor), len(piece.steps) - 1)))
    rows = rows.astype(np.int64)
    free = tuple(np.minimum(np.searchsorted(rows, piece.free), len(rows) - 1).tolist())
    return replace(piece, steps=piece.steps[rows], free=free)


def vote(indices: Sequence[int], pieces: Sequence[Sequence[Piece]], words: Sequence[str]) -> list[int]:
    """Returns which demonstrations, by their place in the list, have the most common sequence of pieces.

    Args:
        indices: Their episodes in the dataset, for a message.
        pieces: Their pieces.
        words: Their sequences in words.

    Raises:
        DatasetError: None moves anything, or two sequences are equally common.
    """
    roles = [tuple(piece.role for piece in each) for each in pieces]
    counts = Counter(role for role in roles if role).most_common()
    if not counts:
        raise DatasetError(
            "No source demonstration moves an object or a part with the hand for long enough. Lower "
            "augment.least_steps, or state the task's segments."
        )
    if len(counts) > 1 and counts[0][1] == counts[1][1]:
        listed = "; ".join(
            f"{index}: {said or 'nothing'}" for index, said in zip(indices, words, strict=True)
        )
        raise DatasetError(
            f"The source demonstrations do different things, and none is the most common ({listed}). Give "
            "more of them, or state the task's segments."
        )
    return [row for row, role in enumerate(roles) if role == counts[0][0]]


def _final_grasp(demo: SourceDemo, movement: Movement) -> tuple[int, int]:
    """Returns the first step of the carry that is not let go again, and the step at which its reach begins.

    Between two stretches, a gripper that opens and closes is another grasp; the reach then begins where it
    opens.
    """
    lift, opened = movement.first, 0
    for (begun, _), (again, _) in zip(movement.stretches, movement.stretches[1:], strict=False):
        changes = [step for step in demo.gripper_changes if begun < step <= again]
        if len(changes) >= 2:
            lift, opened = again, changes[0]
    return lift, opened


def _clear(demo: SourceDemo, let_go: int) -> int:
    """Returns the first step after ``let_go`` at which the hand is clear of what it left."""
    here = demo.commanded.rows(min(let_go, demo.num_steps - 1))
    away = distance_m(demo.commanded.rows(slice(let_go, None)), here)
    far = np.flatnonzero(away > CLEAR_M)
    return let_go + int(far[0]) if len(far) else demo.num_steps


def _pieces(demo: SourceDemo, span: _Span, refine: bool) -> list[Piece]:
    """Returns the pieces of a span: one, or two where the hand first reaches and then acts."""

    def piece(first: int, last: int, anchor: int, contact: int, lift_m: float) -> Piece:
        steps = _steps(demo, first, last)
        free = _free(demo, steps, contact, lift_m)
        if not lift_m:
            near = _near(demo, steps[: free[1] + 1])
            steps, free = steps[near:], (0, free[1] - near)
        return Piece(
            reference=span.reference,
            carried=span.carried,
            subtask=span.subtask,
            steps=steps,
            anchor=anchor,
            free=free,
        )

    if span.carried:
        return [piece(span.first, span.last, span.first, span.contact, LIFT_M)]
    changes = [step for step in demo.gripper_changes if span.first < step <= span.contact]
    act = changes[-1] if changes else span.contact
    if not refine or not span.first < act < span.last:
        return [piece(span.first, span.last, act, act, 0.0)]
    return [piece(span.first, act, act, act, 0.0), piece(act, span.last, act, act, 0.0)]


def _steps(demo: SourceDemo, first: int, last: int) -> np.ndarray:
    """Returns the steps from ``first`` to ``last`` without what is beyond :data:`WAIT_STEPS` of waiting."""
    way = demo.commanded.rows(slice(first, last))
    later, before = way.rows(slice(1, None)), way.rows(slice(None, -1))
    still = (distance_m(later, before) < STILL_M) & (angle_rad(later, before) < STILL_RAD)
    waited, kept = 0, [first]
    for step, waits in zip(range(first + 1, last), still.tolist(), strict=True):
        waited = waited + 1 if waits and step not in demo.gripper_changes else 0
        if waited <= WAIT_STEPS:
            kept.append(step)
    return np.array(kept, np.int64)


def _near(demo: SourceDemo, steps: np.ndarray) -> int:
    """Returns the first of some steps from which on the hand's way is at most :data:`REACH_M` long."""
    pos = demo.commanded.pos[steps]
    left = np.cumsum(np.linalg.norm(np.diff(pos, axis=0), axis=1)[::-1])[::-1]
    return int((left > REACH_M).sum())


def _free(demo: SourceDemo, steps: np.ndarray, contact: int, lift_m: float) -> tuple[int, int]:
    """Returns the window of a piece far from where it begins and from its contact.

    Without one, it is the moment that is farthest from both.
    """
    way = demo.commanded.rows(steps[: max(1, int(np.searchsorted(steps, contact, side="right")))])
    there = demo.commanded.rows(min(contact, demo.num_steps - 1))
    before, after = distance_m(way, way.rows(0)), distance_m(way, there)
    if lift_m:
        aside = np.linalg.norm((way.pos - there.pos)[:, :2], axis=1)
        far = np.flatnonzero((after > LEAD_CARRIED_M) | ((aside > ASIDE_M) & (after > NEAR_M)))
    else:
        far = np.flatnonzero(after > LEAD_M)
    end = int(far[-1]) + 1 if len(far) else 0
    begin = int(np.argmax(before >= lift_m)) if lift_m else 0
    if begin < end:
        return begin, min(end, len(steps) - 1)
    moment = int(np.argmax(np.minimum(before, after))) if lift_m else 0
    return moment, moment

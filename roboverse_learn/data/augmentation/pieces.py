"""Cuts demonstrations into pieces: each a hand path relative to one object, with one skill.

A movement of a carried object is three pieces: *reach* it and, from where the gripper begins to close, *grasp*
it, both relative to the object; then *carry* it relative to its target. A moved part is two: reach it, and
move it. The cut where the skill changes is where a plan may be refined by where the object then is.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from envs.core.errors import DatasetError
from envs.tasks.segment import Segment
from roboverse_learn.data.augmentation.movements import Movement
from roboverse_learn.data.augmentation.pose import distance_m
from roboverse_learn.data.augmentation.recording import SourceDemo, named

LEAD_M = 0.10
"""The last part of a way to an object or a target, which is kept as the source has it."""

LIFT_M = 0.05
"""The first part of the way of a carried object, likewise: it is lifted first."""

CLEAR_M = 0.08
"""Distance of the hand from where it let go, from which on it may go to the next object."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Piece:
    """Steps ``first`` to ``last`` of a demonstration, the second excluded.

    Attributes:
        reference: Object or part that the hand moves relative to.
        carried: Object that the hand carries, or empty.
        subtask: Number of the movement that it belongs to, from 0.
        first: First step.
        last: One past the last step.
        free: First and one past the last step, counted from ``first``, in which the hand may leave the
            source's path; equal for a moment at which it may wait.
    """

    reference: str
    carried: str
    subtask: int
    first: int
    last: int
    free: tuple[int, int]

    @property
    def role(self) -> tuple[str, str, int]:
        """What the pieces of all sources at one place have in common."""
        return self.reference, self.carried, self.subtask


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
    for number, movement in enumerate(found):
        is_last = number == len(found) - 1
        if "/" in movement.moved:
            end = demo.num_steps if is_last else _clear(demo, movement.last)
            spans.append(_Span(movement.moved, "", number, begin, end, movement.first))
        else:
            lift, opened = _final_grasp(demo, movement)
            let_go = next((step for step in demo.gripper_changes if step > lift), movement.last)
            end = demo.num_steps if is_last else _clear(demo, let_go)
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


def vote(
    cuts: Sequence[tuple[SourceDemo, Sequence[Piece]]], words: Sequence[str]
) -> tuple[list[int], list[int]]:
    """Returns which demonstrations have the most common sequence of pieces, and which have another.

    Args:
        cuts: Each demonstration with its pieces.
        words: Each one's sequence, for a message.

    Raises:
        DatasetError: None moves anything, or two sequences are equally common.
    """
    roles = [tuple(piece.role for piece in pieces) for _, pieces in cuts]
    counts = Counter(role for role in roles if role).most_common()
    if not counts:
        raise DatasetError(
            "No source demonstration moves an object or a part with the hand for long enough. Lower "
            "augment.least_steps, or state the task's segments."
        )
    if len(counts) > 1 and counts[0][1] == counts[1][1]:
        told = "; ".join(f"{cuts[row][0].index}: {words[row]}" for row in range(len(cuts)))
        raise DatasetError(
            f"The source demonstrations do different things, and none is the most common ({told}). Give more of "
            "them, or state the task's segments."
        )
    kept = [row for row, role in enumerate(roles) if role == counts[0][0]]
    return kept, [row for row in range(len(cuts)) if row not in kept]


def dropped_words(cuts: Sequence[tuple[SourceDemo, Sequence[Piece]]], words: Sequence[str], kept: list[int]) -> str:
    """Says which demonstrations are left out, and why."""
    others = [row for row in range(len(cuts)) if row not in kept]
    told = "; ".join(f"demonstration {cuts[row][0].index}: {words[row] or 'nothing'}" for row in others)
    return (
        f"{len(kept)} of {len(cuts)} source demonstrations do the same: {words[kept[0]]}. Left out are "
        f"{named([cuts[row][0].index for row in others])} ({told})."
    )


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

    def piece(first: int, last: int, free: tuple[int, int]) -> Piece:
        return Piece(
            reference=span.reference,
            carried=span.carried,
            subtask=span.subtask,
            first=first,
            last=last,
            free=free,
        )

    if span.carried:
        return [piece(span.first, span.last, _free(demo, span.first, span.contact, lift_m=LIFT_M))]
    changes = [step for step in demo.gripper_changes if span.first < step <= span.contact]
    act = changes[-1] if changes else span.contact
    free = _free(demo, span.first, act, lift_m=0.0)
    if not refine or not span.first < act < span.last:
        return [piece(span.first, span.last, free)]
    return [piece(span.first, act, free), piece(act, span.last, (0, 0))]


def _free(demo: SourceDemo, first: int, contact: int, *, lift_m: float) -> tuple[int, int]:
    """Returns the window, counted from ``first``, far from where a piece begins and from its contact.

    Without one, it is the moment that is farthest from both.
    """
    contact = min(max(contact, first + 1), demo.num_steps - 1)
    way = demo.commanded.rows(slice(first, contact + 1))
    before, after = distance_m(way, way.rows(0)), distance_m(way, way.rows(-1))
    far = np.flatnonzero(after > LEAD_M)
    end = int(far[-1]) + 1 if len(far) else 0
    begin = int(np.argmax(before >= lift_m)) if lift_m else 0
    if begin < end:
        return begin, end
    moment = int(np.argmax(np.minimum(before, after))) if lift_m else 0
    return moment, moment

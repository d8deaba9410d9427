"""How much a policy's instruction matters: the right one against each instruction test, episode by episode.

Both rates count success in the task itself, also where it was not asked for. With a wrong, an empty or a
switched instruction a policy that reads does not succeed, so its difference is near its success rate; one
that ignores the instruction has a difference of 0. With another wording of the right one a policy that
understands it has a difference of 0.

:func:`wording_gaps` compares wordings of the train split with held-out ones: what new frames and new words
cost, whatever a wording unlike the task's own sentences costs.
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from benchmark.protocol import HELD_OUT, KNOWN, Cell
from benchmark.records import EpisodeRecord
from benchmark.statistics import mcnemar, paired_difference
from envs.core.errors import ResultError


@dataclass(frozen=True, kw_only=True, slots=True)
class PairedComparison:
    """Two success rates of the same episodes, run twice: how far the second is below the first.

    Attributes:
        split: One of :data:`~envs.randomization.splits.SPLIT_NAMES`.
        episodes: Number of episodes, each run twice.
        difference: The first rate less the second.
        ci_low: Lower end of its 95 % interval; see :func:`~benchmark.statistics.paired_difference`.
        ci_high: Upper end.
        p_value: Exact McNemar test, two-sided.
    """

    split: str
    episodes: int
    difference: float
    ci_low: float
    ci_high: float
    p_value: float

    def to_json(self) -> dict[str, Any]:
        """Returns plain JSON values."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True, slots=True)
class InstructionScore(PairedComparison):
    """The right instruction against one test.

    Attributes:
        instruction_test: One of :data:`~benchmark.protocol.INSTRUCTION_TESTS`.
        right_rate: Success rate with the task's own words, that of level 0.
        test_rate: Success rate in the same task in the test.
    """

    instruction_test: str
    right_rate: float
    test_rate: float


@dataclass(frozen=True, kw_only=True, slots=True)
class WordingGap(PairedComparison):
    """Known wordings against held-out ones.

    Attributes:
        wording: One of :data:`~benchmark.protocol.HELD_OUT`.
        known_rate: Success rate with wordings of the train split.
        held_out_rate: Success rate with held-out ones.
    """

    wording: str
    known_rate: float
    held_out_rate: float


def instruction_scores(records: Iterable[EpisodeRecord]) -> tuple[InstructionScore, ...]:
    """Returns the scores of every instruction test of one evaluation, in the order of its cells.

    Raises:
        ResultError: An episode of a test has no twin with the right instruction, or began in another state.
    """
    by_cell = _by_cell(records)
    return tuple(
        _score(cell, members, by_cell.get(cell.right, {}))
        for cell, members in by_cell.items()
        if cell.instruction_test is not None
    )


def wording_gaps(records: Iterable[EpisodeRecord]) -> tuple[WordingGap, ...]:
    """Returns what held-out wordings cost, by kind and split, in the order of the cells.

    There is none without the test ``known``. Records of several tasks give the gap over all of them.

    Raises:
        ResultError: An episode has no twin with a known wording, or began in another state.
    """
    by_cell = _by_cell(records)
    return tuple(
        _gap(cell, members, known)
        for cell, members in by_cell.items()
        if cell.instruction_test in HELD_OUT and (known := by_cell.get(cell.tested_as(KNOWN)))
    )


_Episodes = Mapping[tuple[str, int], EpisodeRecord]
"""Records by task and episode."""


def _by_cell(records: Iterable[EpisodeRecord]) -> dict[Cell, dict[tuple[str, int], EpisodeRecord]]:
    by_cell: dict[Cell, dict[tuple[str, int], EpisodeRecord]] = {}
    for record in records:
        by_cell.setdefault(record.cell, {})[record.task, record.episode] = record
    return by_cell


def _score(cell: Cell, tested: _Episodes, right: _Episodes) -> InstructionScore:
    assert cell.instruction_test is not None
    right_rate, test_rate, shared = _compared(cell, tested, right, "at level 0")
    return InstructionScore(
        instruction_test=cell.instruction_test, right_rate=right_rate, test_rate=test_rate, **asdict(shared)
    )


def _gap(cell: Cell, tested: _Episodes, known: _Episodes) -> WordingGap:
    assert cell.instruction_test is not None
    known_rate, held_out_rate, shared = _compared(cell, tested, known, "with a known wording")
    return WordingGap(
        wording=cell.instruction_test, known_rate=known_rate, held_out_rate=held_out_rate, **asdict(shared)
    )


def _compared(
    cell: Cell, tested: _Episodes, others: _Episodes, where: str
) -> tuple[float, float, PairedComparison]:
    """Returns the success rate of the others, that of the tested, and their comparison."""
    for key, record in tested.items():
        twin = others.get(key)
        if twin is None or twin.initial_state_hash != record.initial_state_hash:
            raise ResultError(
                f"Episode {record.episode} of {cell} has no twin {where} that begins in the same state. "
                "Evaluate both."
            )
    pairs = [(others[key].success, record.success) for key, record in tested.items()]
    only_other, only_tested = pairs.count((True, False)), pairs.count((False, True))
    both, neither = pairs.count((True, True)), pairs.count((False, False))
    difference, low, high = paired_difference(both, only_other, only_tested, neither)
    comparison = PairedComparison(
        split=cell.split,
        episodes=len(tested),
        difference=difference,
        ci_low=low,
        ci_high=high,
        p_value=mcnemar(only_other, only_tested),
    )
    return (both + only_other) / len(pairs), (both + only_tested) / len(pairs), comparison

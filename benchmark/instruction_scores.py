"""How much a policy's instruction matters: the right one against each instruction test, episode by episode.

Both rates count success in the task itself, also where it was not asked for. With a wrong, an empty or a
switched instruction a policy that reads does not succeed, so its difference is near its success rate; one
that ignores the instruction has a difference of 0. With another wording of the right one a policy that
understands it has a difference of 0.
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from benchmark.protocol import Cell
from benchmark.records import EpisodeRecord
from benchmark.statistics import mcnemar, paired_difference
from envs.core.errors import ResultError


@dataclass(frozen=True, kw_only=True, slots=True)
class InstructionScore:
    """The right instruction against one test, on the same episodes.

    Attributes:
        instruction_test: One of :data:`~benchmark.protocol.INSTRUCTION_TESTS`.
        split: ``"train"`` or ``"test"``.
        episodes: Number of episodes, each run twice.
        right_rate: Success rate with the task's own words, that of level 0.
        test_rate: Success rate in the same task in the test.
        difference: ``right_rate - test_rate``.
        ci_low: Lower end of its 95 % interval; see :func:`~benchmark.statistics.paired_difference`.
        ci_high: Upper end.
        p_value: Exact McNemar test, two-sided.
    """

    instruction_test: str
    split: str
    episodes: int
    right_rate: float
    test_rate: float
    difference: float
    ci_low: float
    ci_high: float
    p_value: float

    def to_json(self) -> dict[str, Any]:
        """Returns plain JSON values."""
        return asdict(self)


def instruction_scores(records: Iterable[EpisodeRecord]) -> tuple[InstructionScore, ...]:
    """Returns the scores of every instruction test of one evaluation, in the order of its cells.

    Raises:
        ResultError: An episode of a test has no twin with the right instruction, or began in another state.
    """
    by_cell: dict[Cell, dict[int, EpisodeRecord]] = {}
    for record in records:
        by_cell.setdefault(record.cell, {})[record.episode] = record
    return tuple(
        _score(cell, members, by_cell.get(cell.right, {}))
        for cell, members in by_cell.items()
        if cell.instruction_test is not None
    )


def _score(
    cell: Cell, tested: Mapping[int, EpisodeRecord], right: Mapping[int, EpisodeRecord]
) -> InstructionScore:
    for episode, record in tested.items():
        twin = right.get(episode)
        if twin is None or twin.initial_state_hash != record.initial_state_hash:
            raise ResultError(
                f"Episode {episode} of {cell} has no twin at level 0 that begins in the same state. Evaluate "
                "both."
            )
    pairs = [(right[episode].success, record.success) for episode, record in tested.items()]
    only_right, only_test = pairs.count((True, False)), pairs.count((False, True))
    both, neither = pairs.count((True, True)), pairs.count((False, False))
    difference, low, high = paired_difference(both, only_right, only_test, neither)
    assert cell.instruction_test is not None
    return InstructionScore(
        instruction_test=cell.instruction_test,
        split=cell.split,
        episodes=len(pairs),
        right_rate=(both + only_right) / len(pairs),
        test_rate=(both + only_test) / len(pairs),
        difference=difference,
        ci_low=low,
        ci_high=high,
        p_value=mcnemar(only_right, only_test),
    )

"""How much the instruction matters, by hand and against published intervals."""

from dataclasses import replace

import pytest

from benchmark.instruction_scores import instruction_scores, wording_gaps
from benchmark.protocol import Protocol
from benchmark.statistics import paired_difference, wilson
from envs.core.errors import ResultError


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ((1, 1, 7, 12), (-0.286, -0.507, -0.026)),  # Bentur 2009, in Fagerland et al. 2014, table V
        ((36, 12, 2, 0), (0.2, 0.0569, 0.3404)),  # Newcombe 1998, table II, method 10
    ],
)
def test_paired_difference_of_published_tables(table, expected):
    assert paired_difference(*table) == pytest.approx(expected, abs=5e-4)


def test_paired_difference_by_hand():
    """Without a correlation it is the root of the summed squares of the distances to Wilson's ends."""
    low, high = wilson(20, 20)[0], wilson(0, 20)[1]
    difference, lower, upper = paired_difference(0, 20, 0, 0)
    assert (difference, upper) == (1.0, 1.0)
    assert lower == pytest.approx(1 - ((1 - low) ** 2 + high**2) ** 0.5)
    assert 0.7 < lower < 0.8, "20 of 20 against 0 of 20 is not certain"


def test_outcomes_that_agree_have_a_narrower_interval():
    alike, unlike = paired_difference(40, 10, 0, 50), paired_difference(20, 30, 20, 30)
    assert alike[0] == unlike[0] == pytest.approx(0.1)
    assert alike[2] - alike[1] < 0.7 * (unlike[2] - unlike[1])


def test_exchanged_policies_have_the_opposite_difference():
    one, other = paired_difference(10, 7, 2, 5), paired_difference(10, 2, 7, 5)
    assert one == pytest.approx((-other[0], -other[2], -other[1]))


def test_a_paired_difference_needs_episodes():
    with pytest.raises(ValueError, match="given 0 of 0"):
        paired_difference(0, 0, 0, 0)


PROTOCOL = Protocol(levels=(0,), splits=("test",), episodes=4, instructions=("known", "wrong"))
OUTCOMES = {None: (1, 1, 1, 0), "known": (1, 1, 0, 1), "wrong": (0, 0, 1, 0)}


@pytest.fixture
def records(make_records):
    return [
        replace(record, success=bool(OUTCOMES[record.instruction_test][record.episode - 9000]))
        for record in make_records(PROTOCOL)
    ]


def test_scores_by_hand(records):
    known, wrong = instruction_scores(records)
    assert (known.instruction_test, known.split, known.episodes) == ("known", "test", 4)
    assert (known.right_rate, known.test_rate, known.difference) == (0.75, 0.75, 0.0)
    assert (wrong.right_rate, wrong.test_rate, wrong.difference) == (0.75, 0.25, 0.5)
    assert (wrong.ci_low, wrong.ci_high) == pytest.approx(paired_difference(1, 2, 0, 1)[1:])
    assert wrong.p_value == pytest.approx(0.5)  # 2 discordant episodes, both for the right instruction


def test_the_order_of_records_has_no_influence(records):
    assert instruction_scores(records[::-1])[::-1] == instruction_scores(records)


def test_an_episode_without_its_twin_is_an_error(records):
    right, rest = records[0], records[1:]
    with pytest.raises(ResultError, match=r"Episode 9000 of instruction known.* has no twin at level 0"):
        instruction_scores(rest)
    other = replace(right, initial_state_hash="f" * 16)
    with pytest.raises(ResultError, match="begins in the same state"):
        instruction_scores([other, *rest])


WORDED = Protocol(levels=(0,), splits=("test",), episodes=4, instructions=("known", "new_frame", "new_words"))
READ = {None: (1, 1, 1, 1), "known": (1, 1, 1, 0), "new_frame": (1, 1, 0, 1), "new_words": (1, 0, 0, 0)}


def read(records, outcomes=READ):
    return [
        replace(record, success=bool(outcomes[record.instruction_test][record.episode - 9000]))
        for record in records
    ]


def test_gaps_between_wordings_by_hand(make_records):
    frame, words = wording_gaps(read(make_records(WORDED)))
    assert (frame.wording, frame.split, frame.episodes) == ("new_frame", "test", 4)
    assert (frame.known_rate, frame.held_out_rate, frame.difference) == (0.75, 0.75, 0.0)
    assert (words.wording, words.known_rate, words.held_out_rate) == ("new_words", 0.75, 0.25)
    assert (words.difference, words.p_value) == (0.5, pytest.approx(0.5))
    assert (words.ci_low, words.ci_high) == pytest.approx(paired_difference(1, 2, 0, 1)[1:])


def test_the_gap_is_to_known_wordings_and_not_to_the_tasks_own(make_records):
    records = read(make_records(WORDED), READ | {None: (0, 0, 0, 0)})
    assert wording_gaps(records) == wording_gaps(read(make_records(WORDED)))


def test_the_gap_over_several_tasks_pairs_the_episodes_of_each(make_records):
    """Episodes of two tasks have equal numbers; the second task reads everything."""
    all_read = {test: (1, 1, 1, 1) for test in READ}
    both = read(make_records(WORDED)) + read(make_records(WORDED, task="StackCube"), all_read)
    _, words = wording_gaps(both)
    assert (words.episodes, words.known_rate, words.held_out_rate) == (8, 7 / 8, 5 / 8)
    assert (words.ci_low, words.ci_high) == pytest.approx(paired_difference(5, 2, 0, 1)[1:])


def test_without_known_wordings_there_is_no_gap(make_records):
    protocol = replace(WORDED, instructions=("new_frame", "new_words"))
    assert wording_gaps(read(make_records(protocol))) == ()


def test_a_wording_without_a_known_twin_is_an_error(make_records):
    records = read(make_records(WORDED))
    lost = next(record for record in records if record.instruction_test == "known")
    with pytest.raises(ResultError, match=r"9000 of instruction new f.* no twin with a known wording"):
        wording_gaps([record for record in records if record is not lost])

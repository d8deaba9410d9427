import math

import pytest

from envs.core.errors import DatasetError
from roboverse_learn.data.collection.pool import together

ATTEMPTS = [(index, None) for index in range(3)]


def test_attempts_within_the_time_form_one_group():
    assert list(together(ATTEMPTS, within_s=math.inf)) == [ATTEMPTS]


def test_attempts_further_apart_form_groups_of_their_own():
    assert list(together(ATTEMPTS, within_s=0.0)) == [[attempt] for attempt in ATTEMPTS]


def test_nothing_is_yielded_without_an_attempt():
    assert list(together([])) == []


def test_attempts_before_an_error_are_yielded_first():
    def broken():
        yield from ATTEMPTS
        raise DatasetError("The disk is full.")

    groups = together(broken(), within_s=math.inf)
    assert next(groups) == ATTEMPTS
    with pytest.raises(DatasetError, match="The disk is full"):
        next(groups)

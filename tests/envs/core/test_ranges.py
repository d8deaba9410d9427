"""One message for every number that is out of its range."""

import math
from dataclasses import dataclass

import pytest

from envs.core.errors import ConfigError, PolicyError
from envs.core.ranges import check_ranges


@dataclass(frozen=True)
class Settings:
    size_m: float | None = 1.0
    delay_s: float = 0.0
    count: int = 1

    def check(self, **how):
        check_ranges(self, above_0=("size_m",), from_0=("delay_s",), from_1=("count",), **how)


@pytest.mark.parametrize("size_m", [1.0, 5e-324, math.inf, None])
def test_numbers_at_their_limits_and_absent_ones_are_in_range(size_m):
    Settings(size_m=size_m).check()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"size_m": 0}, "size_m must be above 0, given 0."),
        ({"size_m": -1.5}, "size_m must be above 0, given -1.5."),
        ({"size_m": math.nan}, "size_m must be above 0, given nan."),
        ({"delay_s": -0.1}, "delay_s must be 0 or more, given -0.1."),
        ({"delay_s": math.nan}, "delay_s must be 0 or more, given nan."),
        ({"count": 0}, "count must be at least 1, given 0."),
    ],
)
def test_a_number_out_of_range_is_named_with_its_limit(values, message):
    with pytest.raises(ConfigError) as error:
        Settings(**values).check()
    assert str(error.value) == message


def test_prefix_unit_and_class_of_the_error_are_those_given():
    with pytest.raises(PolicyError, match=r"policy\.size_m must be above 0 m, given 0"):
        Settings(size_m=0).check(prefix="policy.", unit=" m", error=PolicyError)

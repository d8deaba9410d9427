"""Shaping functions against their closed forms."""

import math

import pytest
import torch

from envs.core.errors import ConfigError, UnknownNameError
from envs.tasks.rewards import tolerance

VALUES = torch.tensor([-3.0, -1.0, 0.0, 0.5, 1.0, 2.0, 5.0], dtype=torch.float64)


def test_within_the_bounds_it_is_one_and_without_a_margin_nothing_outside():
    assert tolerance(VALUES, 0.0, 1.0).tolist() == [0, 0, 1, 1, 1, 0, 0]
    assert tolerance(VALUES, 0.5, math.inf).tolist() == [0, 0, 0, 1, 1, 1, 1]


@pytest.mark.parametrize("shape", ["gaussian", "linear", "quadratic"])
def test_reward_at_either_margin_is_value_at_margin(shape):
    at = tolerance(torch.tensor([-2.0, 3.0]), 0.0, 1.0, margin=2.0, value_at_margin=0.3, shape=shape)
    assert at.tolist() == pytest.approx([0.3, 0.3])


@pytest.mark.parametrize("shape", ["gaussian", "linear", "quadratic"])
def test_it_falls_on_either_side(shape):
    rewards = tolerance(VALUES, 0.0, 1.0, margin=2.0, shape=shape)
    assert (rewards[:3].diff() >= 0).all()
    assert (rewards[3:].diff() <= 0).all()
    assert ((rewards >= 0) & (rewards <= 1)).all()


def test_the_shapes_are_those_of_the_paper():
    half = torch.tensor([1.0])
    assert tolerance(half, margin=2.0).item() == pytest.approx(0.1**0.25)
    assert tolerance(half, margin=2.0, shape="linear", value_at_margin=0.0).item() == pytest.approx(0.5)
    assert tolerance(half, margin=2.0, shape="quadratic", value_at_margin=0.0).item() == pytest.approx(0.75)


def test_what_makes_no_sense_is_refused():
    with pytest.raises(ConfigError, match=r"lower bound of a tolerance, 2.0, is above its upper bound, 1.0"):
        tolerance(VALUES, 2.0, 1.0)
    with pytest.raises(ConfigError, match=r"margin of a tolerance must not be negative, given -1.0"):
        tolerance(VALUES, margin=-1.0)
    with pytest.raises(ConfigError, match=r"A gaussian tolerance at its margin is in \(0, 1\), given 0.0"):
        tolerance(VALUES, margin=1.0, value_at_margin=0.0)
    with pytest.raises(UnknownNameError, match=r"shape of a tolerance 'linaer'.*Did you mean 'linear'"):
        tolerance(VALUES, margin=1.0, shape="linaer")

"""Shaping functions of rewards, on tensors of any shape."""

import math
from typing import Literal

import torch
from torch import Tensor

from envs.core.errors import ConfigError, unknown_name

_SHAPES = ("gaussian", "linear", "quadratic")


def tolerance(
    value: Tensor,
    low: float = 0.0,
    high: float = 0.0,
    *,
    margin: float = 0.0,
    value_at_margin: float = 0.1,
    shape: Literal["gaussian", "linear", "quadratic"] = "gaussian",
) -> Tensor:
    """Returns 1 within bounds, and less outside of them, in [0, 1]: dm_control's ``rewards.tolerance``.

    Tunyasuvunakool et al., "dm_control: Software and tasks for continuous control" (arXiv:2006.12983),
    ``dm_control/utils/rewards.py``, Apache-2.0. With d the distance from the bounds over ``margin``, the
    reward is exp(−(s d)²/2), max(0, 1 − s d) or max(0, 1 − (s d)²), where s makes it ``value_at_margin`` at
    d = 1.

    Args:
        value: The values.
        low: Least value with a reward of 1.
        high: Largest value with a reward of 1; may be infinite.
        margin: Distance from the bounds at which the reward is ``value_at_margin``; at 0 it is 0 outside.
        value_at_margin: See ``margin``; above 0 for ``gaussian``.
        shape: How the reward falls.

    Raises:
        ConfigError: if the bounds, the margin or the value at it make no sense.
    """
    if low > high:
        raise ConfigError(f"The lower bound of a tolerance, {low}, is above its upper bound, {high}.")
    if margin < 0.0:
        raise ConfigError(f"The margin of a tolerance must not be negative, given {margin}.")
    if shape not in _SHAPES:
        raise unknown_name("shape of a tolerance", str(shape), _SHAPES)
    least = 0.0 if shape != "gaussian" else math.ulp(0.0)
    if not least <= value_at_margin < 1.0:
        valid = "(0, 1)" if least else "[0, 1)"
        raise ConfigError(f"A {shape} tolerance at its margin is in {valid}, given {value_at_margin}.")
    outside = (low - value).clamp(min=0.0) + (value - high).clamp(min=0.0)
    if margin == 0.0:
        return (outside == 0.0).to(value.dtype)
    distance = outside / margin
    if shape == "gaussian":
        return torch.exp(math.log(value_at_margin) * distance**2)
    if shape == "linear":
        return (1.0 - (1.0 - value_at_margin) * distance).clamp(min=0.0)
    return (1.0 - (1.0 - value_at_margin) * distance**2).clamp(min=0.0)

"""Parameters of tasks: fields of their dataclasses with the values that they may have.

A parameter is set by key (``task_kwargs.cube_half_size_m=0.03``) or by argument
(``PickCube(cube_half_size_m=0.03)``). Scene, initial states, expert and success rule read the same field.
"""

import math
from collections.abc import Sequence
from dataclasses import Field, dataclass, field, fields
from numbers import Real
from typing import Any, Literal, get_args, get_origin

from envs.core.errors import ConfigError, unknown_name

_KEY = "bounds"


@dataclass(frozen=True, slots=True)
class Bounds:
    """What a number may be.

    Attributes:
        low: Smallest value.
        high: Largest value.
        above: Whether ``low`` itself is excluded.
        ordered: Whether the value is an interval ``(low, high)``.
    """

    low: float
    high: float
    above: bool
    ordered: bool

    def hold(self, value: float) -> bool:
        """Whether one number is inside."""
        return (self.low < value if self.above else self.low <= value) and value <= self.high

    def __str__(self) -> str:
        parts = []
        if math.isfinite(self.low):
            parts.append(f"{'above' if self.above else 'at least'} {self.low:g}")
        if math.isfinite(self.high):
            parts.append(f"at most {self.high:g}")
        return " and ".join(parts) or "finite"


def parameter(
    default: Any, *, above: float | None = None, at_least: float = -math.inf, at_most: float = math.inf
) -> Any:
    """Returns a field of a task: a number, or several, with the limits of each.

    Args:
        default: Its value; None is allowed where it is None.
        above: A limit that a value must exceed.
        at_least: Smallest value; not with ``above``.
        at_most: Largest value.
    """
    return _field(default, above, at_least, at_most, ordered=False)


def interval(
    default: tuple[float, float],
    *,
    above: float | None = None,
    at_least: float = -math.inf,
    at_most: float = math.inf,
) -> Any:
    """Returns a field of a task: an interval ``(low, high)``, with the limits of both ends."""
    return _field(default, above, at_least, at_most, ordered=True)


def is_parameter(item: Field) -> bool:
    """Whether a field is a number, or several."""
    return _KEY in item.metadata or isinstance(item.default, Real | tuple)


def check_parameters(task: Any) -> None:
    """Checks the fields of a task that are made by :func:`parameter` or :func:`interval`, or are choices.

    Raises:
        ConfigError: A value is no number, out of its limits, or an interval whose ends are exchanged.
        UnknownNameError: A value is none of a ``Literal``.
    """
    for item in fields(task):
        value = getattr(task, item.name)
        if get_origin(item.type) is Literal and value not in get_args(item.type):
            raise unknown_name(f"{item.name} of {task.name}", str(value), get_args(item.type))
        bounds = item.metadata.get(_KEY)
        if bounds is not None and not (value is None and item.default is None):
            _check(f"{item.name} of {task.name}", value, item.default, bounds)


def _field(default: Any, above: float | None, at_least: float, at_most: float, *, ordered: bool) -> Any:
    low = at_least if above is None else above
    return field(default=default, metadata={_KEY: Bounds(low, at_most, above is not None, ordered)})


def _check(what: str, value: Any, default: Any, bounds: Bounds) -> None:
    several = isinstance(default, tuple)
    listed = several and isinstance(value, Sequence) and not isinstance(value, str)
    numbers: list[Any] = list(value) if listed else [value]
    count = len(default) if several else 1
    if len(numbers) != count or not all(isinstance(n, Real) and not isinstance(n, bool) for n in numbers):
        kind = f"{count} numbers, such as {list(default)}" if several else "a number"
        raise ConfigError(f"{what} must be {kind}, given {value!r}.")
    if not all(math.isfinite(n) and bounds.hold(n) for n in numbers):
        raise ConfigError(f"{what} must be {bounds}, given {value!r}.")
    if bounds.ordered and numbers[0] > numbers[1]:
        raise ConfigError(f"{what} is an interval [low, high]; low is above high, given {value!r}.")

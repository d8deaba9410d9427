"""Ranges of the numbers of a settings dataclass, with one message for each kind of range."""

import math
from collections.abc import Iterable

from envs.core.errors import ConfigError, RoboVerseError


def check_ranges(
    settings: object,
    prefix: str = "",
    *,
    above_0: Iterable[str] = (),
    from_0: Iterable[str] = (),
    from_1: Iterable[str] = (),
    unit: str = "",
    error: type[RoboVerseError] = ConfigError,
) -> None:
    """Checks fields of a dataclass, in its ``__post_init__``; a field that is None is not checked.

    Args:
        settings: The dataclass.
        prefix: What the message has before the field's name, such as ``policy.``.
        above_0: Fields that must be above 0.
        from_0: Fields that must be 0 or more.
        from_1: Fields that must be at least 1.
        unit: Unit of the limit, with a space before it.
        error: What is raised.
    """
    kinds = ((above_0, math.nextafter(0, 1), "above 0"), (from_0, 0, "0 or more"), (from_1, 1, "at least 1"))
    for names, least, said in kinds:
        for name in names:
            value = getattr(settings, name)
            if value is not None and not value >= least:  # NaN is in no range
                raise error(f"{prefix}{name} must be {said}{unit}, given {value}.")

"""Randomization levels: a level is a set of channels, and each level contains the one below."""

from envs.core.errors import ConfigError, unknown_name
from envs.randomization.channels import CHANNELS

LEVEL_CHANNELS = ("task", "environment", "camera", "lighting")
"""What levels vary. ``task`` always does: object poses and the instruction."""

LEVELS = (0, 1, 2, 3)
"""Level ``k`` varies the first ``k + 1`` channels."""


def parse_level(level: int | str) -> int:
    """Returns ``level`` as an integer of :data:`LEVELS`; accepts 2 and ``"2"``.

    Raises:
        ConfigError: if it is no level.
    """
    text = str(level).strip()
    if isinstance(level, bool) or not text.isdecimal() or int(text) not in LEVELS:
        meanings = "; ".join(f"{k}: {' + '.join(LEVEL_CHANNELS[: k + 1])}" for k in LEVELS)
        raise ConfigError(f"Unknown level '{level}'. Valid levels: {meanings}.")
    return int(text)


def channels_of(level: int | str = 0, only: str | None = None) -> tuple[str, ...]:
    """Returns the channels that vary: those of :data:`LEVEL_CHANNELS` in their order, then others as given.

    Args:
        level: A level, cumulative.
        only: A list of channels in place of a level, such as ``"camera"`` or ``"camera+lighting"``, of
            everything that is registered (:data:`envs.randomization.channels.CHANNELS`). The task varies
            with them.

    Raises:
        ConfigError: if it is no level, or if both a level above 0 and ``only`` are given.
        UnknownNameError: if a part of ``only`` is no channel.
    """
    k = parse_level(level)
    if only is None:
        return LEVEL_CHANNELS[: k + 1]
    names = dict.fromkeys(str(only).split("+"))
    for name in names:
        if name != "task" and name not in CHANNELS:
            raise unknown_name("channel", name, ("task", *CHANNELS))
    if k:
        raise ConfigError(
            f"Given level={k} and only='{only}'. A level is cumulative and 'only' is a list of channels by "
            f"itself: give one of them."
        )
    of_levels = [channel for channel in LEVEL_CHANNELS if channel == "task" or channel in names]
    return tuple(dict.fromkeys([*of_levels, *names]))

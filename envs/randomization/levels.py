"""Randomization levels: a level is a set of channels, and each level contains the one below."""

from envs.core.errors import ConfigError, unknown_name

CHANNELS = ("task", "environment", "camera", "lighting")
"""Everything that can vary. ``task`` always does: object poses and the instruction."""

LEVELS = (0, 1, 2, 3)
"""Level ``k`` varies the first ``k + 1`` channels."""


def parse_level(level: int | str) -> int:
    """Returns ``level`` as an integer of :data:`LEVELS`; accepts 2 and ``"2"``.

    Raises:
        ConfigError: if it is no level.
    """
    text = str(level).strip()
    if isinstance(level, bool) or not text.isdecimal() or int(text) not in LEVELS:
        meanings = "; ".join(f"{k}: {' + '.join(CHANNELS[: k + 1])}" for k in LEVELS)
        raise ConfigError(f"Unknown level '{level}'. Valid levels: {meanings}.")
    return int(text)


def channels_of(level: int | str = 0, only: str | None = None) -> tuple[str, ...]:
    """Returns the channels that vary, in the order of :data:`CHANNELS`.

    Args:
        level: A level, cumulative.
        only: One channel that varies alone (the task always varies with it), instead of a level.

    Raises:
        ConfigError: if it is no level, or if both a level above 0 and ``only`` are given.
        UnknownNameError: if ``only`` is no channel.
    """
    k = parse_level(level)
    if only is None:
        return CHANNELS[: k + 1]
    if only not in CHANNELS:
        raise unknown_name("channel", str(only), CHANNELS)
    if k:
        raise ConfigError(
            f"Given level={k} and only='{only}'. A level is cumulative and 'only' is one channel by "
            f"itself: give one of them."
        )
    return tuple(channel for channel in CHANNELS if channel in ("task", only))

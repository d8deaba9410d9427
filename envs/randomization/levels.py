"""Randomization levels, which are lists of channels: 0 to 3, each with the one below, and named ones."""

from collections.abc import Iterator

from envs.core.errors import ConfigError, suggest, unknown_name
from envs.core.registry import OF_YOUR_OWN, Registry
from envs.randomization.channels import CHANNELS

LEVEL_CHANNELS = ("task", "environment", "camera", "lighting")
"""What levels vary. ``task`` always does: object poses and the instruction."""

LEVELS = (0, 1, 2, 3)
"""Level ``k`` varies the first ``k + 1`` channels."""

NAMED_LEVELS: "Registry[tuple[str, ...]]" = Registry("level", group="roboverse.levels")
"""Lists of channels with a name, of other packages: taken wherever channels are, as in ``only=weather``.

The protocol's levels keep their numbers; so results of a named level are never ranked with theirs.
"""


def parse_level(level: int | str) -> int:
    """Returns ``level`` as an integer of :data:`LEVELS`; accepts 2 and ``"2"``.

    Raises:
        ConfigError: if it is no level.
    """
    text = str(level).strip()
    if isinstance(level, bool) or not text.isdecimal() or int(text) not in LEVELS:
        raise unknown_level(level)
    return int(text)


def unknown_level(level: object, channels_key: str = "only={}") -> ConfigError:
    """Builds the error for what is no level, with the key that takes it where it is a list of channels.

    Args:
        level: What was given.
        channels_key: The word that gives a list of channels, such as a named level, instead.
    """
    text = str(level).strip()
    meanings = "; ".join(f"{k}: {' + '.join(LEVEL_CHANNELS[: k + 1])}" for k in LEVELS)
    meant = {name: channels_key.format(name) for name in (*CHANNELS, *NAMED_LEVELS)}
    if text in meant:
        kind = "a named level" if text in NAMED_LEVELS else "a channel"
        hint = f" '{text}' is {kind}: give {meant[text]}."
    elif text.lstrip("+-").replace(".", "").isdecimal():
        hint = ""
    else:
        others = f" Channels and named levels are given by {channels_key.format('<name>')}."
        hint = suggest(text, meant, meant) or others
    return ConfigError(f"Unknown level '{level}'. Valid levels: {meanings}.{hint}")


def channels_of(level: int | str = 0, only: str | None = None) -> tuple[str, ...]:
    """Returns the channels that vary: those of :data:`LEVEL_CHANNELS` in their order, then others as given.

    Args:
        level: A level, cumulative.
        only: A list of channels in place of a level, such as ``"camera"`` or ``"camera+lighting"``, of
            everything that is registered (:data:`envs.randomization.channels.CHANNELS`); a name of
            :data:`NAMED_LEVELS` stands for its channels. The task varies with them.

    Raises:
        ConfigError: if it is no level, or if both a level above 0 and ``only`` are given.
        UnknownNameError: if a part of ``only``, or of a named level, is no channel.
    """
    k = parse_level(level)
    if only is None:
        return LEVEL_CHANNELS[: k + 1]
    names = dict.fromkeys(name for part in str(only).split("+") for name in _channels_in(part))
    if k:
        raise ConfigError(
            f"Given level={k} and only='{only}'. A level is cumulative and 'only' is a list of channels by "
            f"itself: give one of them."
        )
    of_levels = [channel for channel in LEVEL_CHANNELS if channel == "task" or channel in names]
    return tuple(dict.fromkeys([*of_levels, *names]))


def _channels_in(part: str) -> Iterator[str]:
    """Yields the channels that one part of a list names: itself, or those of a named level."""
    if part == "task" or part in CHANNELS:
        yield part
        return
    if part not in NAMED_LEVELS:
        raise unknown_name("channel", part, ("task", *CHANNELS, *NAMED_LEVELS), OF_YOUR_OWN)
    for name in NAMED_LEVELS.get(part):
        if name != "task" and name not in CHANNELS:
            raise unknown_name(f"channel of the level '{part}'", name, ("task", *CHANNELS), OF_YOUR_OWN)
        yield name

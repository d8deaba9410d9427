"""What may stand behind ``=``: Hydra's grammar, whose refusals become messages of ours."""

from collections.abc import Iterator
from typing import Any

from envs.core.errors import ConfigError

UNKNOWN = object()
"""Default of a key of which only the scene of a task knows what kind of value it takes."""

_CLOSED_BY = {"[": "]", "{": "}", "(": ")"}


def check_value(word: str, command: str, default: Any) -> None:
    """Refuses a value that Hydra cannot read, or reads as several.

    Args:
        word: The word ``key=value`` as it was typed.
        command: The command that it was given to.
        default: What its key has by default, a list where it takes one; or :data:`UNKNOWN`.

    Raises:
        ConfigError: It is neither one value nor one list.
    """
    from hydra.errors import HydraException

    key, _, value = word.partition("=")
    try:
        override = _parsed(value)
    except HydraException as error:
        wrong = f"{_wrong(value)} {_instead(key, value, default)}"
        raise ConfigError(f"'{word}' cannot be read: {wrong}") from error
    if override.is_sweep_override():
        runs = f" For a run with each of them: roboverse sweep {word}" if command == "train" else ""
        raise ConfigError(f"'{word}' gives several values. {_instead(key, value, default)}{runs}")
    if isinstance(override.value(), dict) and default is not UNKNOWN:
        raise ConfigError(f"'{word}' gives keys of its own. {_instead(key, '', default)}")


def _parsed(value: str) -> Any:
    from hydra.core.override_parser.overrides_parser import OverridesParser

    return OverridesParser.create().parse_override(f"key={value}")


def _wrong(value: str) -> str:
    """Says why a value cannot be read."""
    opened, stray = _left_over(value)
    if opened:
        return f"the {opened[-1]} is not closed{f' before the {stray}' if stray else ''}."
    if stray:
        return f"the {stray} closes nothing."
    return (
        "a value is a number, a word, true, false, null, a list such as [1,2], or keys such as {a:1,b:2}; "
        "any other text stands in quotes."
    )


def _instead(key: str, value: str, default: Any) -> str:
    """Says what to write instead of a value."""
    if default is not UNKNOWN and not isinstance(default, list):
        such = "" if default in (None, "") else f", such as {key}={str(default).lower()}"
        return f"{key} takes one value{such}."
    nearest = next(filter(_is_one, _nearby(value)), None) if value else None
    if nearest is None:
        return "Give one value, or a list in brackets."
    if default is UNKNOWN and nearest == f"[{value}]":
        return f"If a list is meant, write {key}={nearest}."
    return f"Write {key}={nearest}."


def _nearby(value: str) -> Iterator[str]:
    """Yields what may have been meant, the likeliest first."""
    opened, _ = _left_over(value)
    yield value + "".join(_CLOSED_BY.get(each, each) for each in reversed(opened))
    if not any(bracket in value for bracket in "[]{}()"):
        yield f"[{value}]"
    yield value[:-1]
    yield f"[{value}"
    yield f"[{value[1:-1]}]"


def _is_one(value: str) -> bool:
    from hydra.errors import HydraException

    try:
        return not _parsed(value).is_sweep_override()
    except HydraException:
        return False


def _left_over(value: str) -> tuple[list[str], str]:
    """Returns the brackets, or the quote, that are not closed, and the first bracket that closes nothing."""
    opened: list[str] = []
    escaped = False
    for char in value:
        quoted = bool(opened) and opened[-1] in "'\""
        if escaped or char == "\\":
            escaped = not escaped
        elif quoted and char == opened[-1]:
            opened.pop()
        elif quoted:
            continue
        elif char in _CLOSED_BY or char in "'\"":
            opened.append(char)
        elif char in _CLOSED_BY.values():
            if not opened or _CLOSED_BY[opened[-1]] != char:
                return opened, char
            opened.pop()
    return opened, ""

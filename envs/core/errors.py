"""Every error a user can cause, in one tree.

A message says what was given, what is valid, and what to do. The command line prints the message
alone and exits with code 2; a traceback is for bugs.
"""

import difflib
from collections.abc import Iterable, Mapping
from typing import Any


class RoboVerseError(Exception):
    """Base of every error that a user can cause and fix."""


class UnknownNameError(RoboVerseError, KeyError):
    """A name that is not registered: a task, a policy, a simulator, a robot, a key."""

    def __str__(self) -> str:  # KeyError shows the repr of its argument
        return str(self.args[0]) if self.args else ""


class UnknownOptionError(UnknownNameError, TypeError):
    """An option that a function does not have: a TypeError, as Python itself raises."""


class ConfigError(RoboVerseError, ValueError):
    """A value of the right name and the wrong kind, range or combination."""


class MissingAssetError(ConfigError):
    """A folder of assets that is not on this machine."""


class SimulatorError(RoboVerseError, RuntimeError):
    """A simulator or renderer cannot do what was requested."""


class MissingExtraError(RoboVerseError, ImportError):
    """An optional package that is not installed."""


class DatasetError(RoboVerseError, ValueError):
    """A dataset is absent, truncated, or of an unexpected shape."""


class PolicyError(RoboVerseError, ValueError):
    """A policy that is configured, loaded or called wrongly."""


class WriteError(RoboVerseError, OSError):
    """A file or folder that cannot be written: the disk is full, or the folder is forbidden or locked."""


class LockedError(WriteError):
    """A folder that another process writes to."""


class CheckpointError(RoboVerseError, ValueError):
    """A checkpoint that is absent, incomplete, or of another policy."""


class ResultError(RoboVerseError, ValueError):
    """A results file that does not follow the schema."""


class UnregisteredError(ResultError):
    """A whole results file of a channel or level that is not registered here, such as one of a plugin."""


class ForeignFileError(ResultError):
    """A file among the results that something else wrote: it is not to be removed."""


_LEAST_LETTERS = 3
"""Of a name that is looked for inside valid ones; two letters are in many."""

MOST_LISTED = 60
"""Valid names that a message lists; of more it names the nearest."""


def suggest(given: str, valid: Iterable[str], meant: Mapping[str, str] | None = None) -> str:
    """Returns ``" Did you mean 'x'?"`` for a valid name, or an empty string.

    It is the shortest one that begins with what was given, else the nearest, else the shortest that contains
    it.

    Args:
        given: What was given.
        valid: Every valid name.
        meant: What is suggested for each of them; the name itself by default.
    """
    lowered = {name.lower(): (meant or {}).get(name, name) for name in valid}
    given = given.lower()
    holding = [name for name in lowered if given in name] if len(given) >= _LEAST_LETTERS else []
    holding.sort(key=lambda name: (len(name), name))
    beginning = [name for name in holding if name.startswith(given)]
    found = beginning or difflib.get_close_matches(given, lowered, n=1) or holding
    return f" Did you mean '{lowered[found[0]]}'?" if found else ""


def unknown_name(
    kind: str, given: str, valid: Iterable[str], hint: str = "", other: Mapping[str, str] | None = None
) -> UnknownNameError:
    """Builds the error for an unregistered name.

    Args:
        kind: What the name should have named, such as ``"task"``.
        given: What was given.
        valid: Every valid name.
        hint: One more sentence: what to do.
        other: Names by which others know some of the valid ones, which are suggested for them.
    """
    names = sorted(valid)
    near = suggest(given, [*names, *(other or {})], other)
    message = f"Unknown {kind} '{given}'.{near} {_listed(kind, given, names)}"
    return UnknownNameError(f"{message} {hint}".rstrip())


def _listed(kind: str, given: str, names: list[str]) -> str:
    """Lists valid names; of many, those that are nearest."""
    if len(names) <= MOST_LISTED:
        return f"Valid: {', '.join(names) or 'none'}."
    lowered = {name.lower(): name for name in names}
    near = [lowered[name] for name in difflib.get_close_matches(given.lower(), lowered, n=5, cutoff=0.0)]
    every = " roboverse list tasks shows all." if kind == "task" else ""
    return f"Nearest of {len(names)}: {', '.join(near)}.{every}"


def empty_path(key: str) -> ConfigError:
    """Builds the error for a key of a file or folder whose value is empty: it would be the current folder."""
    return ConfigError(
        f"{key}= is empty, and names a file or folder: give one, or leave {key}= out. A variable of the "
        "shell that is not set is empty, too."
    )


def unknown_option(what: str, given: str, valid: Iterable[str]) -> UnknownOptionError:
    """Builds the error for an option that ``what`` does not have, in the words that libraries look for."""
    names = sorted(valid)
    message = f"{what} got an unexpected keyword argument '{given}'.{suggest(given, names)}"
    return UnknownOptionError(f"{message} Valid: {', '.join(names)}.")


def wrong_value(item: Mapping[str, Any]) -> str:
    """Says what is wrong with a value: one of the ``errors()`` of pydantic's ``ValidationError``."""
    if item["type"] in ("tuple_type", "list_type"):
        said = "input should be a list in brackets, such as [1,2]"
    else:
        said = f"{item['msg'][0].lower()}{item['msg'][1:]}"
    return f"{said}, given {item['input']!r}."

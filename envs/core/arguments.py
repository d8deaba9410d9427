"""Command-line arguments, ``key=value``, as the fields of a dataclass: for programs run as ``python -m``."""

import inspect
import logging
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from envs.core.docstrings import plain
from envs.core.errors import ConfigError, RoboVerseError, empty_path, unknown_name

_BOOLEANS = {"true": True, "yes": True, "false": False, "no": False}


@dataclass(frozen=True, slots=True)
class NoSettings:
    """The command takes no arguments."""


def run_program[T](
    command: str, settings: type[T], run: Callable[[T], int | None], words: Sequence[str] | None = None
) -> int:
    """Runs a program with the settings that its words give; see :func:`parse`. Its log is printed.

    Returns:
        Its exit code, 0 for None; 2, after one line that says what to do, for an error that the user can
        correct.
    """
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    try:
        return run(parse(command, settings, words)) or 0
    except RoboVerseError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2


def parse[T](command: str, settings: type[T], words: Sequence[str] | None = None) -> T:
    """Parses arguments into settings; a field without an argument keeps its default.

    Values are written as on every command line: ``task=PickCube``, ``record=true``,
    ``redraw=[PickCube,CloseBox]``. ``--help`` prints the settings' docstring and those of the dataclasses
    that they inherit from, and ends the program.

    Args:
        command: What is run, such as ``"python -m envs.experts.check"``.
        settings: A dataclass whose fields have defaults, and are texts, numbers, booleans, paths, or tuples
            of one of these. One named ``from_`` is typed ``from=``, a word of Python.
        words: The words; the program's own by default.

    Raises:
        ConfigError: if a word is no ``key=value``, or a value is of another type.
        UnknownNameError: if no field has that name.
    """
    words = sys.argv[1:] if words is None else words
    if {"-h", "--help", "help"} & set(words):
        about = [plain(inspect.cleandoc(cls.__doc__ or "")) for cls in settings.__mro__ if is_dataclass(cls)]
        sys.stdout.write("\n\n".join([f"{command} key=value …", *about]) + "\n")
        raise SystemExit(0)
    hints = get_type_hints(settings)
    field_of = {field.name.removesuffix("_"): field.name for field in fields(settings)}  # pyright: ignore[reportArgumentType]
    kinds = {key: hints[name] for key, name in field_of.items()}
    values: dict[str, Any] = {}
    for word in words:
        if not kinds:
            raise ConfigError(f"{command} takes no words, given '{word}'.")
        key, equals, text = word.partition("=")
        if not equals:
            raise ConfigError(f"'{word}' is no key=value. Keys of {command}: {', '.join(kinds)}.")
        if key not in kinds:
            raise unknown_name(f"key of {command}", key, kinds)
        values[field_of[key]] = _value(key, text, kinds[key])
    return settings(**values)


def read_list(key: str, text: str) -> tuple[str, ...]:
    """Returns the items of a list, ``[A,B]`` or ``A,B``.

    Raises:
        ConfigError: if a bracket is missing.
    """
    listed = text.startswith("[") and text.endswith("]")
    if text.startswith("[") != listed:
        raise ConfigError(f"The value of '{key}={text}' cannot be read: a list is [A,B].")
    items = [item.strip() for item in (text[1:-1] if listed else text).split(",")]
    return tuple(item for item in items if item)


def _value(key: str, text: str, kind: Any) -> Any:
    """Returns a text as a value of a field's type."""
    if isinstance(kind, UnionType):
        if text in ("", "null", "None"):
            return None
        kind = next(option for option in get_args(kind) if option is not NoneType)
    if get_origin(kind) is tuple:
        return tuple(_value(key, item, get_args(kind)[0]) for item in read_list(key, text))
    text = text.strip("'\"")
    if kind is Path and not text.strip():
        raise empty_path(key)
    if kind is bool:
        if text.lower() not in _BOOLEANS:
            raise ConfigError(f"{key}: given '{text}'. It is true or false.")
        return _BOOLEANS[text.lower()]
    try:
        return kind(text)
    except ValueError:
        raise ConfigError(f"{key}: given '{text}'. It is of the type {kind.__name__}.") from None

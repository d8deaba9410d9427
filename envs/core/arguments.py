"""Words of a command line, ``key=value``, as the fields of a dataclass: for what is run as ``python -m``."""

import inspect
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

from envs.core.errors import ConfigError, RoboVerseError, unknown_name


@dataclass(frozen=True, slots=True)
class NoSettings:
    """It takes no words."""


def run_program[T](
    command: str, settings: type[T], run: Callable[[T], int], words: Sequence[str] | None = None
) -> int:
    """Runs a program with the settings that its words give; see :func:`parse`.

    Returns:
        Its exit code; 2, after one line that says what to do, for a mistake that the user can mend.
    """
    try:
        return run(parse(command, settings, words))
    except RoboVerseError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2


def parse[T](command: str, settings: type[T], words: Sequence[str] | None = None) -> T:
    """Returns the settings that the words give; what they leave out keeps its default.

    Values are YAML, as everywhere else: ``task=PickCube``, ``record=true``, ``redraw=[PickCube,CloseBox]``.
    ``--help`` prints what the settings' docstring says of them, and ends the program.

    Args:
        command: What is run, such as ``"python -m envs.experts.check"``.
        settings: A dataclass whose fields have defaults.
        words: The words; the program's own by default.

    Raises:
        ConfigError: if a word is no ``key=value``, or a value is of another kind.
        UnknownNameError: if a key is none of the settings'.
    """
    from pydantic import TypeAdapter, ValidationError  # listings import this module, and are quick

    words = sys.argv[1:] if words is None else words
    if {"-h", "--help", "help"} & set(words):
        sys.stdout.write(f"{command} key=value …\n\n{inspect.getdoc(settings)}\n")
        raise SystemExit(0)
    valid = [field.name for field in fields(settings)]  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for word in words:
        if not valid:
            raise ConfigError(f"{command} takes no words, given '{word}'.")
        key, equals, text = word.partition("=")
        if not equals:
            raise ConfigError(f"'{word}' is no key=value. Keys of {command}: {', '.join(valid)}.")
        if key not in valid:
            raise unknown_name(f"key of {command}", key, valid)
        values[key] = _value(word, text)
    try:
        return TypeAdapter(settings).validate_python(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or command
        raise ConfigError(f"{key}: given {first['input']!r}. {first['msg']}.") from None


def _value(word: str, text: str) -> Any:
    import yaml

    try:
        return yaml.safe_load(text)
    except yaml.YAMLError:
        raise ConfigError(f"The value of '{word}' cannot be read; put quotes round it.") from None

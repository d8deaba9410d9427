"""Settings that belong to what was chosen, such as a simulator's, read into its dataclass."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from envs.core.errors import ConfigError, unknown_name, wrong_value


def check_names(settings: type, names: Mapping[str, Any], owner: str) -> None:
    """Checks the names of settings.

    Args:
        settings: The dataclass that has them.
        names: What was given.
        owner: What they are settings of, such as ``simulator=mujoco``.

    Raises:
        UnknownNameError: if there is no such setting.
    """
    known = [field.name for field in fields(settings)]
    for name in names:
        if name not in known:
            raise unknown_name(f"setting of {owner}", name, known)


def typed_settings[T](settings: type[T], values: Mapping[str, Any], section: str, owner: str) -> T:
    """Returns a dataclass of settings from plain values.

    Args:
        settings: The dataclass.
        values: Values by name; the others have their defaults.
        section: The key under which they are given, for a message.
        owner: What they are settings of, such as ``simulator=mujoco``.

    Raises:
        ConfigError: if a setting has an invalid value.
        UnknownNameError: if there is no such setting, or no such value of one.
    """
    from pydantic import TypeAdapter, ValidationError

    check_names(settings, values, owner)
    try:
        return TypeAdapter(settings).validate_python(dict(values))
    except ValidationError as error:
        first = error.errors()[0]
        cause = first.get("ctx", {}).get("error")
        if isinstance(cause, ConfigError):
            raise cause from None
        where = ".".join([section, *map(str, first["loc"])])
        raise ConfigError(f"{where}: {wrong_value(first)}") from None

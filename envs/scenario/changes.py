"""A scenario with some of its values replaced: nested plain values, checked by the dataclasses' own types."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cache
from types import NoneType
from typing import Any, get_args, get_type_hints

from envs.core.errors import ConfigError, unknown_name, wrong_value
from envs.core.json_values import to_json_values

ROOT = "scenario"

_FIXED = ("name", "simulators")
"""By its name a thing is found; settings of simulators are checked by these."""


def changed[T](value: T, changes: Mapping[str, Any], where: str = ROOT) -> T:
    """Returns a frozen dataclass with some of its values replaced.

    Args:
        value: The dataclass, such as a :class:`~envs.scenario.ScenarioCfg`.
        changes: Field to value, nested as the dataclasses are: ``{"physics": {"decimation": 50}}``. Of
            cameras, robots and objects one is chosen by its name, of other things that stand in a row by
            its place: ``{"cameras": {"front": {"fovy_deg": 30.0}}, "appearance": {"lights": {"0": {…}}}}``.
        where: What messages call the dataclass.

    Raises:
        ConfigError: if a value is of another type than its field, or out of its range.
        UnknownNameError: if there is no such field, or nothing of a name.
    """
    known = _field_types(type(value))
    new = {}
    for key, given in changes.items():
        if key not in known:
            raise unknown_name(f"key of {where}", str(key), known)
        new[key] = _new(getattr(value, key), given, known[key], f"{where}.{key}")
    try:
        return replace(value, **new)  # type: ignore[type-var]  # a dataclass, as _field_types has checked
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None


def difference(before: Any, after: Any) -> dict[str, Any]:
    """Returns what :func:`changed` needs to make one dataclass of another, as plain values.

    However it was written, the same change is the same difference, and a change to what was is none.
    """
    return {
        name: _between(getattr(before, name), getattr(after, name))
        for name in _field_types(type(before))
        if getattr(before, name) != getattr(after, name)
    }


def merged(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    """Returns changes and others after them, which win where both say something."""
    both = dict(before)
    for key, value in after.items():
        old = both.get(key)
        if isinstance(value, Mapping) and isinstance(old, Mapping):
            both[key] = merged(old, value)
        else:
            both[key] = value
    return both


def keys_of(cls: type, prefix: str) -> Iterator[tuple[str, type, str]]:
    """Yields the dotted keys of a dataclass and of those in it, with the class and the field of each.

    Entries of a list have ``<name>`` or ``<number>`` in their place.
    """
    for name, hint in _field_types(cls).items():
        own = _dataclass_in(hint)
        if own is None:
            yield f"{prefix}.{name}", cls, name
        elif hint is own or NoneType in get_args(hint):
            yield from keys_of(own, f"{prefix}.{name}")
        else:
            by = "<name>" if _is_mapping(hint) or _has_name(own) else "<number>"
            yield from keys_of(own, f"{prefix}.{name}.{by}")


def _between(old: Any, new: Any) -> Any:
    """Returns the difference of two values of a field; the new one whole, where it is not made of the old."""
    if is_dataclass(old) and is_dataclass(new):
        return difference(old, new)
    before, after = _by_key(old), _by_key(new)
    if before and before.keys() == after.keys():
        return {key: difference(before[key], after[key]) for key in before if before[key] != after[key]}
    return to_json_values(new)


def _by_key(value: Any) -> dict[str, Any]:
    """Returns several dataclasses by their names or their places; nothing for anything else."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        value = {getattr(item, "name", str(place)): item for place, item in enumerate(value)}
    return dict(value) if isinstance(value, Mapping) and all(map(is_dataclass, value.values())) else {}


def _new(old: Any, given: Any, hint: Any, where: str) -> Any:
    if not isinstance(given, Mapping):
        if isinstance(old, Sequence) and any(hasattr(item, "name") for item in old):
            names = ", ".join(item.name for item in old)
            raise ConfigError(
                f"{where} is changed one by one ({names}), as in {where}.<name>.<key>=…; given {given!r}."
            )
        return _value(given, hint, where)
    if is_dataclass(old):
        return changed(old, given, where)
    if isinstance(old, Mapping):
        return {**old, **{key: _one(old, key, inner, where) for key, inner in given.items()}}
    if isinstance(old, Sequence) and all(map(is_dataclass, old)) and _dataclass_in(hint) is not None:
        items = _by_key(old)
        items |= {str(key): _one(items, key, inner, where) for key, inner in given.items()}
        return tuple(items.values())
    if old is None:
        raise ConfigError(f"{where}: this task's scene has none, so nothing of it can be changed.")
    return _value(given, hint, where)


def _one(items: Mapping[str, Any], key: Any, given: Any, where: str) -> Any:
    """Returns one of several things, changed."""
    if str(key) not in items:
        raise unknown_name(f"key of {where}", str(key), items)
    item = items[str(key)]
    if not isinstance(given, Mapping) or not is_dataclass(item):
        keys = f" ({', '.join(_field_types(type(item)))})" if is_dataclass(item) else ""
        raise ConfigError(f"{where}.{key} has keys of its own{keys}; given {given!r}.")
    return changed(item, given, f"{where}.{key}")


def _value(given: Any, hint: Any, where: str) -> Any:
    """Checks a value by the type of its field; lists become tuples, and what they hold dataclasses."""
    own = _dataclass_in(hint)
    if own is not None and not (given is None and NoneType in get_args(hint)):
        if is_dataclass(hint) or NoneType in get_args(hint) or not isinstance(given, Sequence):
            keys = ", ".join(_field_types(own))
            raise ConfigError(f"{where} has keys of its own ({keys}); given {given!r}.")
        for place, item in enumerate(given):
            _check_names(own, item, f"{where}.{place}")
    return typed_value(given, hint, where)


def typed_value(given: Any, hint: Any, where: str) -> Any:
    """Returns a value as one of a type, such as a tuple for a list.

    Args:
        given: A plain value, as the command line or JSON has it.
        hint: The type.
        where: What messages call the value.

    Raises:
        ConfigError: It is none of that type.
    """
    from pydantic import ValidationError  # needed by changed scenes and by options alone

    try:
        return _adapter(hint).validate_python(given)
    except ValidationError as error:
        first = error.errors()[0]
        cause = first.get("ctx", {}).get("error")
        place = ".".join([where, *map(str, first["loc"])])
        said = cause if isinstance(cause, ConfigError) else wrong_value(first)
        raise ConfigError(f"{place}: {said}") from None


def _check_names(cls: type, given: Any, where: str) -> None:
    """Refuses unknown keys of a dataclass that is given whole, which pydantic would pass over."""
    if isinstance(given, Mapping):
        known = [item.name for item in fields(cls)]
        for key in given:
            if key not in known:
                raise unknown_name(f"key of {where}", str(key), known)


@cache
def _adapter(hint: Any) -> Any:
    from pydantic import ConfigDict, TypeAdapter

    return TypeAdapter(hint, config=ConfigDict(allow_inf_nan=False))


@cache
def _field_types(cls: type) -> dict[str, Any]:
    """Returns the fields of a dataclass that may be changed, and their types."""
    hints = get_type_hints(cls)
    return {item.name: hints[item.name] for item in fields(cls) if item.name not in _FIXED}


def _dataclass_in(hint: Any) -> type | None:
    """Returns the dataclass that a type is, or holds."""
    if is_dataclass(hint) and isinstance(hint, type):
        return hint
    return next((own for own in map(_dataclass_in, get_args(hint)) if own is not None), None)


def _is_mapping(hint: Any) -> bool:
    return isinstance(getattr(hint, "__origin__", None), type) and issubclass(hint.__origin__, Mapping)


def _has_name(cls: type) -> bool:
    return any(item.name == "name" for item in fields(cls))

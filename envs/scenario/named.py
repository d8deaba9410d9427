"""References of a scene: files, and materials of the library."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, get_args, get_type_hints

from envs.scenario.changes import ROOT


def named(value: Any, kind: Any, where: str = ROOT) -> Iterator[tuple[str, str]]:
    """Yields every name of a kind in a scene, with its dotted key.

    Args:
        value: A :class:`~envs.scenario.ScenarioCfg`, or a part of one.
        kind: :data:`~envs.scenario.units.AssetRef` or :data:`~envs.scenario.units.MaterialName`.
        where: Key of ``value``.
    """
    if is_dataclass(value):
        hints = get_type_hints(type(value), include_extras=True)
        for item in fields(value):
            inner, hint, key = getattr(value, item.name), hints[item.name], f"{where}.{item.name}"
            if isinstance(inner, str) and kind in (hint, *get_args(hint)):
                yield key, inner
            else:
                yield from named(inner, kind, key)
    elif isinstance(value, Mapping):
        for name, inner in value.items():
            yield from named(inner, kind, f"{where}.{name}")
    elif isinstance(value, Sequence) and not isinstance(value, str):
        for place, inner in enumerate(value):
            yield from named(inner, kind, f"{where}.{getattr(inner, 'name', place)}")

"""The fields of :class:`~envs.spec.EnvSpec` as options of LeRobot's configurations."""

from collections.abc import Mapping
from dataclasses import field, fields, make_dataclass
from typing import Any, get_origin, get_type_hints

from envs.spec import EnvSpec


def with_spec_fields(base: type, **options: Any) -> Any:
    """Returns a dataclass that extends ``base`` by the fields of :class:`~envs.spec.EnvSpec`.

    Args:
        base: A configuration of LeRobot.
        **options: Of :func:`dataclasses.make_dataclass`.
    """
    hints = get_type_hints(EnvSpec)
    added = [
        (
            item.name,
            dict[str, Any] if get_origin(hints[item.name]) is Mapping else hints[item.name],
            field(default=item.default, default_factory=item.default_factory),  # one of them is MISSING
        )
        for item in fields(EnvSpec)
    ]
    return make_dataclass("_SpecOptions", added, bases=(base,), **options)


def spec_of(config: Any) -> EnvSpec:
    """Returns the environment that such a configuration describes."""
    return EnvSpec.from_json({item.name: getattr(config, item.name) for item in fields(EnvSpec)})

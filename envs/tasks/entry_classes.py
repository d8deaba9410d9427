"""A class for each entry of a family's catalogue, made when it is asked for.

A family's module has ``__getattr__ = classes_of(...)``, so that a registered path such as
``envs.tasks.libero.by_name:LiberoGoalTurnOnTheStove`` imports a class that is made on demand.
"""

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any, Protocol, cast

from envs.tasks.base import Task


class NamedEntry(Protocol):
    """What an entry says of its task."""

    @property
    def name(self) -> str:
        """Registered name of the task."""
        ...

    @property
    def class_name(self) -> str:
        """Name of its class."""
        ...


def classes_of[E: NamedEntry, T: Task](
    base: type[T],
    module: str,
    entries: Callable[[], Iterable[E]],
    instructions: Callable[[E], tuple[str, ...]],
) -> Callable[[str], type[T]]:
    """Returns the ``__getattr__`` of a module: class name to class, the same one every time.

    Args:
        base: Class of the family; its ``entry`` is set in each.
        module: Name of the module that gets it.
        entries: Returns the entries; called when the first class is asked for.
        instructions: Returns an entry's instructions.
    """

    @cache
    def by_class() -> dict[str, E]:
        return {entry.class_name: entry for entry in entries()}

    @cache
    def made(class_name: str) -> type[T]:
        entry = by_class()[class_name]
        body: dict[str, Any] = {
            "__doc__": base.__doc__,
            "__module__": module,
            "name": entry.name,
            "instructions": instructions(entry),
            "entry": entry,
        }
        return cast(type[T], type(class_name, (base,), body))

    def class_of(name: str) -> type[T]:
        if name not in by_class():
            raise AttributeError(name)
        return made(name)

    return class_of

"""One registry for everything that has a name: tasks, simulators, renderers, robots."""

import importlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from envs.core.errors import MissingExtraError, unknown_name


@dataclass(frozen=True, slots=True)
class Entry[T]:
    """One registered name.

    Attributes:
        name: The name.
        target: The object, or ``"package.module:Attribute"``, imported at first use.
        tags: Free labels, for listing.
        extra: The optional extra of this distribution that the target needs, if any.
        summary: One line for listings.
        info: Further facts for listings, by name; plain data, so that reading them imports nothing.
    """

    name: str
    target: T | str
    tags: frozenset[str] = frozenset()
    extra: str | None = None
    summary: str = ""
    info: Mapping[str, str] = field(default_factory=dict)


class Registry[T]:
    """Names to objects, with lazy imports and errors that list what is valid.

    Args:
        kind: What is registered, as it reads in an error message (``"task"``).
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._entries: dict[str, Entry[T]] = {}

    def add(
        self,
        name: str,
        target: T | str,
        *,
        tags: frozenset[str] | set[str] = frozenset(),
        extra: str | None = None,
        summary: str = "",
        info: Mapping[str, str] | None = None,
    ) -> None:
        """Registers ``target`` under ``name``; a name can be taken only once."""
        if name in self._entries:
            raise ValueError(f"The {self.kind} '{name}' is registered already.")
        self._entries[name] = Entry(name, target, frozenset(tags), extra, summary, dict(info or {}))

    def decorate(self, name: str, **kwargs) -> Callable[[T], T]:
        """Registers the decorated object; see :meth:`add`."""

        def register(target: T) -> T:
            self.add(name, target, **kwargs)
            return target

        return register

    def entry(self, name: str) -> Entry[T]:
        """Returns the entry of ``name`` without importing its target.

        Raises:
            UnknownNameError: if nothing is registered under that name.
        """
        if name not in self._entries:
            raise unknown_name(self.kind, name, self._entries)
        return self._entries[name]

    def get(self, name: str) -> T:
        """Returns what ``name`` stands for, importing it if it was registered lazily.

        Raises:
            UnknownNameError: if nothing is registered under that name.
            MissingExtraError: if a package of the entry's extra is not installed.
        """
        entry = self.entry(name)
        if not isinstance(entry.target, str):
            return entry.target
        module, _, attribute = entry.target.partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)
        except ModuleNotFoundError as error:
            if entry.extra is None:
                raise
            raise MissingExtraError(
                f"The {self.kind} '{name}' needs the package '{error.name}', which is not installed. "
                f"Install it with: pip install 'roboverse-learn[{entry.extra}]'"
            ) from error

    def names(self, tag: str | None = None) -> list[str]:
        """Returns the registered names, sorted; with ``tag``, only those that carry it."""
        return sorted(n for n, e in self._entries.items() if tag is None or tag in e.tags)

    def __contains__(self, name: str) -> bool:
        return name in self._entries

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def __len__(self) -> int:
        return len(self._entries)

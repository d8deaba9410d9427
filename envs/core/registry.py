"""One registry for everything that has a name: tasks, robots, simulators, renderers, policies, sources."""

import glob
import importlib
import importlib.metadata
import importlib.util
import os
import pkgutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from envs.core.errors import ConfigError, MissingExtraError, RoboVerseError, suggest, unknown_name
from envs.core.extras import install_command

PLUGINS_VARIABLE = "ROBOVERSE_PLUGINS"
"""Environment variable: modules, separated by commas, that are imported before a registry is read.

``plugins=[...]`` of a command sets it, so that the processes that the command starts load them too.
"""

OF_YOUR_OWN = "One of your own is known with plugins=[<package>], or once its package is installed."
"""What to do about an unknown name of what other packages register, too."""


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
        distribution: The installed package that registered it through an entry point; empty for the others.
        module: The module that registered it by a call; empty for those of entry points.
        rivals: What else registers the name with another target. Such a name is listed, and not to be used.
    """

    name: str
    target: T | str
    tags: frozenset[str] = frozenset()
    extra: str | None = None
    summary: str = ""
    info: Mapping[str, str] = field(default_factory=dict)
    distribution: str = ""
    module: str = ""
    rivals: "tuple[Entry[T], ...]" = ()

    @property
    def owner(self) -> str:
        """Who registered it, for a message: ``the package 'lift-block' (lift_block.task:LiftBlock)``."""
        if not self.distribution and self.module.partition(".")[0] in _OURS:
            return "RoboVerse Learn itself"
        who = f"package '{self.distribution}'" if self.distribution else f"module '{self.module}'"
        reference = _reference(self.target)
        return f"the {who}" + (f" ({reference})" if isinstance(reference, str) else "")


class Registry[T]:
    """Names to objects, with lazy imports and errors that list what is valid.

    Args:
        kind: What is registered, as it reads in an error message (``"task"``).
        group: Group of entry points by which other packages register, such as ``"roboverse.tasks"``: the
            entry point's name is the registered name, its value the target.
        default_tags: Tags of what is added without any.
        other_names: Names by which other programs know some of these, which are suggested for them.
    """

    def __init__(
        self,
        kind: str,
        group: str = "",
        default_tags: Iterable[str] = (),
        other_names: Mapping[str, str] | None = None,
    ) -> None:
        self.kind, self.group, self._default_tags = kind, group, frozenset(default_tags)
        self.other_names = dict(other_names or {})
        self._entries: dict[str, Entry[T]] = {}
        self._complete = False

    def add(
        self,
        name: str,
        target: T | str,
        *,
        tags: frozenset[str] | set[str] = frozenset(),
        extra: str | None = None,
        summary: str = "",
        info: Mapping[str, str] | None = None,
        distribution: str = "",
    ) -> None:
        """Registers ``target`` under ``name``; a name can be taken only once.

        The same target again changes nothing: a module that registers itself may have entry points, too.
        Another target for the name of an installed package is an error of :meth:`get`, so that other names
        can still be used.

        Raises:
            ValueError: The name is taken, by no entry point of a package.
        """
        tags = frozenset(tags) or self._default_tags
        module = "" if distribution else _caller()
        entry = Entry(name, target, tags, extra, summary, dict(info or {}), distribution, module)
        known = self._entries.get(name)
        if known is None:
            self._entries[name] = entry
            if module:
                _ADDED_BY[name] = module
        elif not any(_reference(each.target) == _reference(target) for each in (known, *known.rivals)):
            if not (known.distribution or distribution):
                raise ValueError(f"The {self.kind} '{name}' is registered already.")
            self._entries[name] = replace(known, rivals=(*known.rivals, entry))

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
            self._load_others()
        if name not in self._entries:
            raise self.unknown(name)
        return self._entries[name]

    def unknown(self, name: str, *, further: Iterable[str] = (), hint: str = "") -> RoboVerseError:
        """Returns the error of a name that is neither registered nor one of ``further``."""
        hint = hint or (OF_YOUR_OWN if self.group else "")
        return unknown_name(self.kind, name, {*self._entries, *further}, hint, self.other_names)

    def get(self, name: str) -> T:
        """Returns the entry of ``name``, importing it if it was registered lazily.

        Raises:
            UnknownNameError: if nothing is registered under that name.
            MissingExtraError: if a package of the entry's extra is not installed.
            ConfigError: if another package registered it and it cannot be imported from there, or two
                packages registered it.
        """
        entry = self.entry(name)
        if any(_package(rival) != _package(entry) for rival in entry.rivals):
            raise self._conflict(entry)
        target = self._import(entry) if isinstance(entry.target, str) else entry.target
        entry = self.entry(name)
        if entry.rivals:  # of its own package, which the import may have registered
            raise self._conflict(entry)
        return target

    def conflicts(self) -> list[str]:
        """Returns a sentence on every name that is registered with several targets."""
        return [str(self._conflict(self.entry(name))) for name in self if self.entry(name).rivals]

    def _conflict(self, entry: Entry[T]) -> ConfigError:
        owners = ", and by ".join(each.owner for each in (entry, *entry.rivals))
        return ConfigError(
            f"The {self.kind} '{entry.name}' is registered by {owners}. Give one of them another name (of a "
            f"package it is in its entry points, in the group '{self.group}'), or uninstall a package."
        )

    def _import(self, entry: Entry[T]) -> T:
        """Imports the target of a lazy entry; see :meth:`get`."""
        module, _, attribute = str(entry.target).partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError) as error:
            if entry.distribution:
                raise ConfigError(
                    f"The {self.kind} '{entry.name}' of the package '{entry.distribution}' cannot be "
                    f"imported from '{entry.target}': {_said(error)} Mend its entry point in the group "
                    f"'{self.group}', or uninstall the package."
                ) from error
            if entry.extra is None or not isinstance(error, ModuleNotFoundError):
                raise
            raise MissingExtraError(
                f"The {self.kind} '{entry.name}' needs the package '{error.name}', which is not installed. "
                f"Install it with: {install_command(entry.extra)}"
            ) from error
        except RoboVerseError:  # it says by itself what is wrong
            raise
        except (Exception, SystemExit) as error:
            if not entry.distribution:
                raise
            raise ConfigError(
                f"The {self.kind} '{entry.name}' of the package '{entry.distribution}' cannot be imported: "
                f"{type(error).__name__}: {_said(error)} Mend {module}; python -c 'import {module}' shows "
                "where."
            ) from error

    def names(self, tag: str | None = None) -> list[str]:
        """Returns the registered names, sorted; with ``tag``, only those that carry it."""
        self._load_others()
        return sorted(n for n, e in self._entries.items() if tag is None or tag in e.tags)

    def names_so_far(self) -> list[str]:
        """Returns the names that are registered without reading anything else, sorted."""
        return sorted(self._entries)

    def __contains__(self, name: str) -> bool:
        if name not in self._entries:
            self._load_others()
        return name in self._entries

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def __len__(self) -> int:
        return len(self.names())

    def _load_others(self) -> None:
        """Adds what other packages register, once; they are not imported, but for the named plugins.

        Raises:
            ConfigError: A plugin cannot be imported.
        """
        if self._complete or not self.group:
            return
        self._complete = True  # a plugin may read this registry while it is imported
        try:
            try:
                load_plugins()
            finally:
                self._add_entry_points()
        except BaseException:  # whoever reads it next sees the same error, not a registry with gaps
            self._complete = False
            raise

    def _add_entry_points(self) -> None:
        for point in importlib.metadata.entry_points(group=self.group):
            owner = point.dist.name if point.dist else "unknown"
            self.add(point.name, point.value, summary=f"from {owner}", distribution=owner)


def _reference(target: object) -> object:
    """Returns a target as ``"module:Attribute"``; what has no such name is itself."""
    if isinstance(target, str) or not hasattr(target, "__qualname__"):
        return target
    return f"{target.__module__}:{target.__qualname__}"  # type: ignore[attr-defined]


def _package(entry: Entry[Any]) -> str:
    """Returns the name by which what registered an entry is imported."""
    return (str(entry.target) if entry.distribution else entry.module).partition(".")[0].partition(":")[0]


def _said(error: BaseException) -> str:
    """Returns what an error says as a sentence, with the attribute that may be meant."""
    text = str(error)
    text = text if text.endswith((".", "?", "!")) else f"{text}."
    if not isinstance(error, AttributeError) or not error.name:
        return text
    return text + suggest(error.name, (name for name in dir(error.obj) if not name.startswith("_")))


def registered_by_hand() -> list[str]:
    """Returns the names that this process alone knows: neither ours, nor of an entry point or a plugin.

    A script, or a module that it imports, has registered them.
    """
    plugins = {name.partition(".")[0] for name in named_plugins()}
    everywhere = plugins | _OURS
    return sorted(name for name, by in _ADDED_BY.items() if by.partition(".")[0] not in everywhere)


_OURS = {"envs", "policies", "benchmark", "roboverse_learn"}

_ADDED_BY: dict[str, str] = {}
"""Registered name to the module that added it; names of entry points are not in it."""


def _caller() -> str:
    """Returns the name of the module that calls this one."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__") == __name__:
        frame = frame.f_back
    return str(frame.f_globals.get("__name__"))


def load_plugins() -> None:
    """Imports the modules that :data:`PLUGINS_VARIABLE` names; each registers what it has.

    One that is not installed is looked for in the current folder, and in a project folder of its own name
    there.

    Raises:
        ConfigError: One of them cannot be imported; the others are.
    """
    errors: list[RoboVerseError] = []
    for name in named_plugins():
        try:
            _load_plugin(name)
        except RoboVerseError as error:
            errors.append(error)
    if errors:
        raise errors[0]


def leave_out_broken_plugins() -> dict[str, str]:
    """Takes plugins that cannot be imported out of :data:`PLUGINS_VARIABLE`, so that the rest can be used.

    Returns:
        Why each cannot be imported, by its name, with those that this process left out before.
    """
    for name in named_plugins():
        _LEFT_OUT.pop(name, None)
        try:
            _load_plugin(name)
        except RoboVerseError as error:
            _LEFT_OUT[name] = f"{error} The environment variable {PLUGINS_VARIABLE} names it."
    if _LEFT_OUT:
        os.environ[PLUGINS_VARIABLE] = ",".join(name for name in named_plugins() if name not in _LEFT_OUT)
    return dict(_LEFT_OUT)


_LEFT_OUT: dict[str, str] = {}
"""Plugin to why it cannot be imported, of those that were left out."""


def named_plugins() -> list[str]:
    """Returns the modules that :data:`PLUGINS_VARIABLE` names."""
    return list(filter(None, os.environ.get(PLUGINS_VARIABLE, "").split(",")))


def plugins_word() -> str:
    """Returns the word by which another command knows the same plugins, ``plugins=[a,b]``; empty for none."""
    named = named_plugins()
    return f"plugins=[{','.join(named)}]" if named else ""


def _load_plugin(name: str) -> None:
    """Imports one plugin; see :func:`load_plugins`."""
    if not all(part.isidentifier() for part in name.split(".")):
        raise ConfigError(
            f"The plugin '{name}' is no name of a module. Write it as it is imported, without its folder "
            f"and without .py: plugins=[{Path(name).stem or 'my_module'}]"
        )
    package = name.partition(".")[0]
    _find(package)
    try:
        module = importlib.import_module(name)
    except ImportError as error:
        of_a_module = "is not a package" in str(error)  # as in my_module.py
        nearest = suggest(package, _importable()) if error.name == package or of_a_module else ""
        raise ConfigError(
            f"The plugin '{name}' cannot be imported: {_said(error)}{nearest} Install it, run the command in "
            "its folder, or put its folder on PYTHONPATH."
        ) from error
    except RoboVerseError:  # it says by itself what is wrong
        raise
    except (Exception, SystemExit) as error:
        raise ConfigError(
            f"The plugin '{name}' cannot be imported: {type(error).__name__}: {_said(error)} Mend it; "
            f"python -c 'import {name}' shows where."
        ) from error
    if module.__spec__ is not None and module.__spec__.origin is None:
        raise ConfigError(
            f"The plugin '{name}' is a folder without __init__.py, which registers nothing. Name the "
            "module inside it, or run the command where that module is."
        )


def _importable() -> set[str]:
    """Returns the modules that a plugin's name may mean: of the current folder, and installed ones."""
    modules = {each.name for each in pkgutil.iter_modules([*sys.path, str(Path.cwd())])}
    projects = {
        folder
        for folder in glob.glob("*")
        if os.path.isfile(f"{folder}/{folder}.py") or os.path.isfile(f"{folder}/{folder}/__init__.py")
    }
    return (modules | projects) - set(sys.stdlib_module_names) - _OURS


def _find(package: str) -> None:
    """Lets a plugin of the current folder be imported, after everything that is installed."""
    if package in sys.modules:
        return
    found = importlib.util.find_spec(package)
    if found is not None and found.origin is not None:
        return
    for folder in (Path.cwd(), Path.cwd() / package):
        if (folder / f"{package}.py").is_file() or (folder / package / "__init__.py").is_file():
            sys.path.append(str(folder))
            importlib.invalidate_caches()
            return

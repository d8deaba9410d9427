"""A class for each of CALVIN's tasks in each of its scenes, made when it is asked for."""

from functools import cache

from envs.tasks.calvin.catalogue import Entry, entries
from envs.tasks.calvin.task import CalvinTask


def __getattr__(name: str) -> type[CalvinTask]:
    """Returns the class of a task, such as ``CalvinDOpenDrawer``."""
    entry = _by_class().get(name)
    if entry is None:
        raise AttributeError(name)
    return _made(entry)


@cache
def _by_class() -> dict[str, Entry]:
    return {entry.class_name: entry for entry in entries().values()}


@cache
def _made(entry: Entry) -> type[CalvinTask]:
    body = {
        "__doc__": CalvinTask.__doc__,
        "__module__": __name__,
        "name": entry.name,
        "instructions": (entry.facts.instruction,),
        "entry": entry,
    }
    return type(entry.class_name, (CalvinTask,), body)

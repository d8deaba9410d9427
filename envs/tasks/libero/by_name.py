"""A class for each of LIBERO's tasks, made when it is asked for."""

from functools import cache

from envs.tasks.libero.catalogue import Entry, entries, pro_entries
from envs.tasks.libero.task import LiberoTask


def __getattr__(name: str) -> type[LiberoTask]:
    """Returns the class of a task, such as ``Libero90KitchenScene1OpenTheTopDrawerOfTheCabinet``."""
    entry = _by_class().get(name)
    if entry is None:
        raise AttributeError(name)
    return _made(entry)


@cache
def _by_class() -> dict[str, Entry]:
    return {entry.class_name: entry for entry in (*entries().values(), *pro_entries().values())}


@cache
def _made(entry: Entry) -> type[LiberoTask]:
    body = {
        "__doc__": LiberoTask.__doc__,
        "__module__": __name__,
        "name": entry.name,
        "instructions": (entry.instruction,),
        "entry": entry,
    }
    return type(entry.class_name, (LiberoTask,), body)

"""A class for each task, made when it is asked for."""

from functools import cache

from envs.tasks.grasp_language.catalogue import Entry, entries
from envs.tasks.grasp_language.task import GraspByLanguage


def __getattr__(name: str) -> type[GraspByLanguage]:
    """Returns the class of a task, such as ``GraspFewKetchup``."""
    entry = _by_class().get(name)
    if entry is None:
        raise AttributeError(name)
    return _made(entry)


@cache
def _by_class() -> dict[str, Entry]:
    return {entry.class_name: entry for entry in entries().values()}


@cache
def _made(entry: Entry) -> type[GraspByLanguage]:
    body = {
        "__doc__": GraspByLanguage.__doc__,
        "__module__": __name__,
        "name": entry.name,
        "instructions": entry.instructions,
        "entry": entry,
    }
    return type(entry.class_name, (GraspByLanguage,), body)

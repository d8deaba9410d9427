"""The 45 tasks that have no class of their own; one is made on access, as an attribute."""

from functools import cache

from envs.tasks.metaworld.catalogue import PREFIX, VERSION, WORDS
from envs.tasks.metaworld.task import MetaWorldTask


@cache
def task_class(name: str) -> type[MetaWorldTask]:
    """Returns the class of a task of :data:`~envs.tasks.metaworld.catalogue.WORDS`."""
    fields = {
        "__doc__": f"Meta-World's ``{name}{VERSION}``.",
        "__module__": __name__,
        "name": f"{PREFIX}{name}",
        "instructions": WORDS[name],
        "original_name": f"{name}{VERSION}",
    }
    return type(name, (MetaWorldTask,), fields)


def __getattr__(name: str) -> type[MetaWorldTask]:
    if name not in WORDS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return task_class(name)

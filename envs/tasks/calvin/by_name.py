"""A class for each of CALVIN's tasks in each of its scenes, such as ``CalvinDOpenDrawer``."""

from envs.tasks.calvin.catalogue import entries
from envs.tasks.calvin.task import CalvinTask
from envs.tasks.entry_classes import classes_of

__getattr__ = classes_of(
    CalvinTask, __name__, lambda: entries().values(), lambda entry: (entry.facts.instruction,)
)

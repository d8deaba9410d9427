"""A class for each of LIBERO's tasks, such as ``Libero90KitchenScene1OpenTheTopDrawerOfTheCabinet``."""

from envs.tasks.entry_classes import classes_of
from envs.tasks.libero.catalogue import entries, pro_entries
from envs.tasks.libero.task import LiberoTask

__getattr__ = classes_of(
    LiberoTask,
    __name__,
    lambda: (*entries().values(), *pro_entries().values()),
    lambda entry: (entry.instruction,),
)

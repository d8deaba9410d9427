"""A class for each task of grasping by language, such as ``GraspFewKetchup``."""

from envs.tasks.entry_classes import classes_of
from envs.tasks.grasp_language.catalogue import entries
from envs.tasks.grasp_language.task import GraspByLanguage

__getattr__ = classes_of(
    GraspByLanguage, __name__, lambda: entries().values(), lambda entry: entry.instructions
)

"""Which of LIBERO's tasks could be done in the scene of another."""

from functools import cache

from envs.tasks.libero.bddl import Problem, read_problem
from envs.tasks.libero.catalogue import Entry, entries, pro_entries
from envs.tasks.libero.files import problem_file


@cache
def same_scene_tasks(entry: Entry) -> tuple[str, ...]:
    """Returns the names of the tasks of the same scene, with other words, whose goal could be reached there.

    Raises:
        MissingExtraError: The extra ``libero`` is not installed.
    """
    own, pool = _problem(entry), pro_entries() if entry.variant else entries()
    here = [other for other in pool.values() if other.scene_name == entry.scene_name]
    if entry.variant:
        here = [other for other in here if other.folder == entry.folder]
    worded = [other for other in here if other.instruction != entry.instruction]
    return tuple(other.name for other in worded if is_another_goal(own, _problem(other)))


def is_another_goal(own: Problem, other: Problem) -> bool:
    """Returns whether the other task's goal could hold in the own scene, and leaves the own goal open.

    Objects of one kind have numbers that differ between files; they are the same where they begin at the
    same place.
    """
    names = _own_names(own, other)
    goal = {(atom.predicate, *(names.get(arg, arg) for arg in atom.args)) for atom in other.goal}
    places = {*own.objects, *own.fixtures, *own.regions}
    own_goal = {(atom.predicate, *atom.args) for atom in own.goal}
    return all({*args} <= places for _, *args in goal) and not own_goal <= goal


def _own_names(own: Problem, other: Problem) -> dict[str, str]:
    """Returns for objects of the other file the object of the own one of that kind, at that place."""
    here = {(category, *_start(own, name)): name for name, category in own.objects.items()}
    found = {name: (category, *_start(other, name)) for name, category in other.objects.items()}
    return {name: here[key] for name, key in found.items() if len(key) > 1 and key in here}


def _start(problem: Problem, name: str) -> tuple[str, ...]:
    """Returns where an object begins, as the file says it."""
    return next((atom.args[1:] for atom in problem.init if atom.args[0] == name), ())


def _problem(entry: Entry) -> Problem:
    return read_problem(problem_file(entry))

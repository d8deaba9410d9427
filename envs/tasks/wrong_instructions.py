"""Instructions that are wrong in a task's scene: what a policy that reads must not take for its own."""

from collections.abc import Iterable

from envs.core.errors import ConfigError, MissingExtraError
from envs.randomization.language import load_grammar
from envs.tasks import TASKS
from envs.tasks.base import Task

_BENCHMARK = "benchmark"
"""Tag of the tasks that are learned together, and whose words are taken where there are no others."""


def wrong_instructions(task: Task) -> tuple[str, ...]:
    """Returns the first instruction of other tasks, in the order of the registry.

    They are of the tasks that could be done in this scene (:meth:`~envs.tasks.base.Task.same_scene_tasks`). A
    task that names none takes those of tasks that a policy may have learned with it: of the benchmark's if it
    is one of them, else of tasks with its origin, else of the benchmark's. They ask for something else: what
    shares both a verb and a noun with an own instruction, synonyms included, is left out.

    Raises:
        ConfigError: There is no other task.
    """
    same_scene = _words_of(task.same_scene_tasks())
    if same_scene:
        return same_scene
    benchmark = [name for name in TASKS if _BENCHMARK in TASKS.entry(name).tags and name != task.name]
    is_of_it = task.name in TASKS and _BENCHMARK in TASKS.entry(task.name).tags
    for names in (benchmark if is_of_it else [], _of_origin(task), benchmark):
        others = tuple(text for text in _words_of(names) if not might_be_same(task, text))
        if others:
            return others
    raise ConfigError(
        f"No registered task asks for something else than {task.name}. Name tasks of the same scene in its "
        "same_scene_tasks(), or leave the tests with a wrong instruction out."
    )


def _of_origin(task: Task) -> list[str]:
    """Returns the names of the tasks that come from where this one does."""
    if task.name not in TASKS:
        return []
    source = TASKS.entry(task.name).info.get("source")
    found = [name for name in TASKS if source and TASKS.entry(name).info.get("source") == source]
    return [name for name in found if name != task.name]


def _words_of(names: Iterable[str]) -> tuple[str, ...]:
    """Returns the first instruction of each task; one whose extra is not installed is left out."""
    found: dict[str, None] = {}
    for name in names:
        try:
            found[TASKS.get(name).instructions[0]] = None
        except MissingExtraError:
            continue
    return tuple(found)


def might_be_same(task: Task, instruction: str) -> bool:
    """Returns whether an instruction shares a verb and a noun with one of the task's, or is among them."""
    grammar = load_grammar()
    other = grammar.meaning(instruction)
    own = [grammar.meaning(text) for text in task.instructions]
    alike = any(mine["verbs"] & other["verbs"] and mine["nouns"] & other["nouns"] for mine in own)
    return alike or instruction in task.instructions

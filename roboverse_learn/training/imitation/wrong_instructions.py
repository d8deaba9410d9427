"""Instructions that are wrong in the scenes of learned tasks, and what holding still is there."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from envs.core.errors import ConfigError
from envs.randomization.language import load_grammar
from envs.tasks.base import Task
from envs.tasks.wrong_instructions import might_be_same
from policies.base import listed
from policies.learned_tasks import LAST, UNRELATED, ZERO, Instructions, LearnedTask

_NO_VERBS = ("the", "it", "of it")
"""Ends of the grammar's phrases of verbs that are no part of the verb."""


def with_wrong_instructions(instructions: Instructions, tasks: Mapping[str, Task]) -> Instructions:
    """Adds unrelated instructions, and says which instructions are wrong in the scenes of which task.

    Wrong are those of learned tasks that cannot be done in the task's scene and that ask for something
    else, and unrelated ones that name no object of what can be done there. Unrelated ones are a verb and a
    noun of the grammar of wordings; held-out words are not among them. Where tasks were learned in many
    wordings, they have frames as those have, so that a frame says nothing.

    Args:
        instructions: Those of the demonstrations.
        tasks: The learned tasks by name.

    Raises:
        ConfigError: A learned task is none of ``tasks``, or how to hold still in it is unknown.
    """
    grammar = load_grammar()
    learned = []
    for each in instructions.tasks:
        if each.name not in tasks:
            raise ConfigError(
                f"policy.wrong_instructions needs registered tasks, and the dataset has '{each.name}'. "
                f"Known here are {listed(tasks)}. Set it to 0, or register the task."
            )
        learned.append(replace(each, still=still_of(tasks[each.name], each)))
    in_frames = len(instructions.texts) > sum(len(tasks[each.name].instructions) for each in learned)
    frames = grammar.train_frames if in_frames else ("{x}",)
    unrelated = [
        frames[number % len(frames)].format(x=text) for number, text in enumerate(_unrelated_sentences())
    ]
    texts = (*instructions.texts, *unrelated)
    task_of = (*instructions.task_of, *[UNRELATED] * len(unrelated))
    wrong = []
    for task in (tasks[each.name] for each in learned):
        asks_else = [_asks_for_else(task, tasks[other.name]) for other in learned]
        to_do = [tasks[other.name] for other, is_else in zip(learned, asks_else, strict=True) if not is_else]
        there = {noun for each in to_do for text in each.instructions for noun in _nouns(text)}
        is_wrong = [
            asks_else[of] if of != UNRELATED else not _nouns(text) & there
            for text, of in zip(texts, task_of, strict=True)
        ]
        wrong.append(tuple(index for index, each in enumerate(is_wrong) if each))
    return Instructions(texts=texts, tasks=tuple(learned), task_of=task_of, wrong=tuple(wrong))


def still_of(task: Task, learned: LearnedTask | None = None) -> tuple[int, ...]:
    """Returns what keeps the robot of a task still, as :attr:`policies.learned_tasks.LearnedTask.still`.

    Args:
        task: The task.
        learned: What a dataset has of it; by default what the task itself gives.

    Raises:
        ConfigError: It does not follow from what the policy observes, or the dataset has other actions.
    """
    controller = task.controller
    names, states = tuple(controller.names), tuple(task.state_names)
    if learned is not None and (learned.action_names, learned.state_names) != (names, states):
        raise ConfigError(
            f"policy.wrong_instructions needs the states and actions of {task.name} as the task has them, "
            f"and the dataset's actions are {_few(learned.action_names)}, not {_few(names)}. Set it to 0, or "
            "give the task_kwargs that the dataset was collected with."
        )
    held = controller.held
    if len(held) != len(names):
        raise ConfigError(
            f"policy.wrong_instructions needs to know how {task.name} holds still, and its controller "
            f"{type(controller).__name__} does not say it. Set policy.wrong_instructions=0."
        )
    missing = [name for name, kind in zip(names, held, strict=True) if kind == "state" and name not in states]
    if missing:
        raise ConfigError(
            f"policy.wrong_instructions needs the present {_few(missing)} in the observation of {task.name}, "
            "to hold still there. Set it to 0, or take the observation of joints."
        )
    fixed = {"zero": ZERO, "last": LAST}
    return tuple(
        fixed[kind] if kind in fixed else states.index(name) for name, kind in zip(names, held, strict=True)
    )


def _asks_for_else(task: Task, other: Task) -> bool:
    """Whether another task cannot be done in a task's scene, and no instruction of it may mean the task."""
    can_be_done = other.name == task.name or other.name in task.same_scene_tasks()
    return not can_be_done and not any(might_be_same(task, text) for text in other.instructions)


def _nouns(text: str) -> set[int]:
    return load_grammar().meaning(text)["nouns"]


def _unrelated_sentences() -> list[str]:
    grammar = load_grammar()
    phrases = {
        kind: [group.match[0] for group in grammar.synonyms if group.kind == kind]
        for kind in ("verbs", "nouns")
    }
    verbs = dict.fromkeys(_verb(phrase) for phrase in phrases["verbs"])
    return [f"{verb} the {noun}" for verb in verbs for noun in phrases["nouns"]]


def _verb(phrase: str) -> str:
    for end in _NO_VERBS:
        phrase = phrase.removesuffix(f" {end}")
    return phrase


def _few(names: Sequence[str]) -> str:
    return ", ".join([*names[:4], "..."] if len(names) > 4 else names) or "unnamed"

"""Further wordings of learned tasks, from the tasks' banks."""

from envs.spec import EnvSpec
from envs.tasks import TASKS
from policies.learned_tasks import Instructions


def with_bank_wordings(instructions: Instructions) -> Instructions:
    """Adds the known wordings of each task's bank to the instructions of its demonstrations.

    Those of the demonstrations keep their indices; a task that is not registered here keeps its own alone.
    """
    texts, task_of = list(instructions.texts), list(instructions.task_of)
    for number, learned in enumerate(instructions.tasks):
        if learned.name not in TASKS:
            continue
        task = EnvSpec(task=learned.name).make_task()
        own = {text for text, of in zip(texts, task_of, strict=True) if of == number}
        known = [text for text in task.wordings(task.description).known if text not in own]
        texts += known
        task_of += [number] * len(known)
    return Instructions(texts=tuple(texts), tasks=instructions.tasks, task_of=tuple(task_of))

"""CALVIN's tasks and scenes as data; nothing heavy is imported.

``tasks.json`` has, of each task, the sentence of ``mees/calvin``
(``calvin_models/conf/annotations/new_playtable_validation.yaml``), its category in the protocol of chains
(``multistep_sequences.py``), and the rule of ``mees/calvin_env`` (``conf/tasks/new_playtable_tasks.yaml``).
"""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

PREFIX = "calvin/"

SCENES = ("A", "B", "C", "D")

BLOCKS = ("red", "blue", "pink")
"""Colours of the blocks, in the order of CALVIN's evaluation states."""

HORIZON = 360
"""Control steps of one instruction in CALVIN's evaluation."""

FACTS = Path(__file__).with_name("tasks.json")


@dataclass(frozen=True, slots=True)
class TaskFacts:
    """What CALVIN says of a task.

    Attributes:
        instruction: Its sentence of the evaluation.
        category: No chain has two tasks of one category.
        rule: Kind of rule, and its arguments.
    """

    instruction: str
    category: int
    rule: tuple[str | float, ...]


@dataclass(frozen=True, slots=True)
class Entry:
    """A task in a scene.

    Attributes:
        scene: One of :data:`SCENES`.
        task: A name of :func:`task_facts`.
    """

    scene: str
    task: str

    @property
    def name(self) -> str:
        """Registered name, such as ``calvin/D/open_drawer``."""
        return f"{PREFIX}{self.scene}/{self.task}"

    @property
    def class_name(self) -> str:
        """Name of the task's class."""
        return "Calvin" + self.scene + "".join(word.capitalize() for word in self.task.split("_"))

    @property
    def facts(self) -> TaskFacts:
        """What CALVIN says of the task."""
        return task_facts()[self.task]


@cache
def task_facts() -> dict[str, TaskFacts]:
    """Returns the 34 tasks in the order of the protocol of chains."""
    raw = json.loads(FACTS.read_text(encoding="utf-8"))
    return {
        name: TaskFacts(row["instruction"], row["category"], tuple(row["rule"])) for name, row in raw.items()
    }


@cache
def entries() -> dict[str, Entry]:
    """Returns registered name to task, by scene."""
    found = [Entry(scene, task) for scene in SCENES for task in task_facts()]
    return {entry.name: entry for entry in found}

"""Names, words and origin of LIBERO's and LIBERO-PRO's tasks, from data files; nothing heavy is imported.

``python -m docs.generate.libero_catalogue`` writes the files from the packages of the extras ``libero`` and
``libero-pro``.
"""

import json
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

PREFIX, PRO_PREFIX = "libero/", "libero_pro/"

EXTRA, PRO_EXTRA = "libero", "libero-pro"
"""The extras of this distribution that have the task files and the assets."""

CATALOGUE, PRO_CATALOGUE = Path(__file__).with_name("tasks.json"), Path(__file__).with_name("pro_tasks.json")

SUITES = ("spatial", "object", "goal", "10", "90")

PRO_SUITES = ("spatial", "object", "goal", "10")
"""LIBERO's suites that LIBERO-PRO varies (Zhou et al., arXiv:2510.03827)."""

VARIANTS = {
    "swap": "two things have changed places",
    "object": "things of another colour, size or kind",
    "lan": "the same goal in other words",
    "task": "another goal in the same scene",
}
"""LIBERO-PRO's variants, by the ending of the names of its folders, and what differs."""

HORIZON = 600
"""Control steps: the limit of LIBERO's own evaluation (``libero/configs/eval/default.yaml``)."""

LEROBOT_HORIZONS = {"spatial": 280, "object": 280, "goal": 300, "10": 520, "90": 400}
"""Control steps of LeRobot's evaluation (``lerobot/envs/libero.py``), by suite."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One task.

    Attributes:
        suite: One of :data:`SUITES`.
        file: Name of its BDDL file and of its initial states, without the ending.
        instruction: What to do, in LIBERO's words.
        variant: One of :data:`VARIANTS`, or empty for LIBERO's own task.
    """

    suite: str
    file: str
    instruction: str
    variant: str = ""

    @property
    def folder(self) -> str:
        """Suite and variant, as the folders of LIBERO's files are named."""
        return f"{self.suite}_{self.variant}" if self.variant else self.suite

    @property
    def extra(self) -> str:
        """The extra that has its files."""
        return PRO_EXTRA if self.variant else EXTRA

    @property
    def name(self) -> str:
        """Registered name: ``libero/<suite>/<task>`` or ``libero_pro/<suite>_<variant>/<task>``."""
        return f"{PRO_PREFIX if self.variant else PREFIX}{self.folder}/{self.file.lower()}"

    @property
    def class_name(self) -> str:
        """Name of the task's class."""
        words = f"{self.folder}_{self.file}".replace("_", " ").split()
        return ("LiberoPro" if self.variant else "Libero") + "".join(
            word[0].upper() + word[1:].lower() for word in words
        )

    @property
    def scene_name(self) -> str:
        """Name of the scene that several tasks share: ``KITCHEN_SCENE3``, or the suite's, as in ``goal``."""
        found = re.match(r"[A-Z_]+_SCENE\d+", self.file)
        return found[0] if found else self.folder


@cache
def entries() -> dict[str, Entry]:
    """Returns registered name to task, in LIBERO's order of suites and of their tasks."""
    raw = json.loads(CATALOGUE.read_text(encoding="utf-8"))
    found = [Entry(suite, file, words) for suite in SUITES for file, words in raw[suite].items()]
    return {entry.name: entry for entry in found}


@cache
def pro_entries() -> dict[str, Entry]:
    """Returns registered name to task of LIBERO-PRO, by suite and variant, in LIBERO's order of tasks."""
    raw = json.loads(PRO_CATALOGUE.read_text(encoding="utf-8"))
    found = [
        Entry(suite, file, words, variant)
        for suite in PRO_SUITES
        for variant in VARIANTS
        for file, words in raw[f"{suite}_{variant}"].items()
    ]
    return {entry.name: entry for entry in found}

"""Names, words and origin of LIBERO's tasks, from a data file; nothing heavy is imported.

``python -m docs.generate.libero_catalogue`` writes the file from the packages of the extra ``libero``.
"""

import json
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

PREFIX = "libero/"

EXTRA = "libero"
"""The extra of this distribution that has the assets."""

CATALOGUE = Path(__file__).with_name("tasks.json")

SUITES = ("spatial", "object", "goal", "10", "90")

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
    """

    suite: str
    file: str
    instruction: str

    @property
    def name(self) -> str:
        """Registered name, in lower case: ``libero/<suite>/<task>``."""
        return f"{PREFIX}{self.suite}/{self.file.lower()}"

    @property
    def class_name(self) -> str:
        """Name of the task's class."""
        words = f"{self.suite}_{self.file}".replace("_", " ").split()
        return "Libero" + "".join(word[0].upper() + word[1:].lower() for word in words)

    @property
    def scene_name(self) -> str:
        """Name of the scene that several tasks share: ``KITCHEN_SCENE3``, or the suite's, as in ``goal``."""
        found = re.match(r"[A-Z_]+_SCENE\d+", self.file)
        return found[0] if found else self.suite


@cache
def entries() -> dict[str, Entry]:
    """Returns registered name to task, in LIBERO's order of suites and of their tasks."""
    raw = json.loads(CATALOGUE.read_text(encoding="utf-8"))
    found = [Entry(suite, file, words) for suite in SUITES for file, words in raw[suite].items()]
    return {entry.name: entry for entry in found}

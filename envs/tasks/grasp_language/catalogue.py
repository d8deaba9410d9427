"""Names, words and sets of the tasks, from a data file; nothing heavy is imported.

``rest`` of an object is the orientation in which LIBERO puts it (wxyz): measured from its initial states, and
after its ``hope_objects.py`` where no task has the object.
"""

import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

PREFIX = "grasp/"

EXTRA = "libero"
"""The extra of this distribution that has the objects."""

CATALOGUE = Path(__file__).with_name("sets.json")

SETS = ("few", "many", "unseen", "colours_1", "colours_2", "colours_3")

HORIZON = 200
"""Control steps after which an episode is cut off: 10 s."""


@dataclass(frozen=True, slots=True)
class Grocery:
    """One object.

    Attributes:
        name: LIBERO's name of it; where it has another colour, with the colour before it.
        words: What instructions call it.
        rest: Orientation in which it stands, wxyz.
        asset: LIBERO's name of its files.
        colour: Colour that its files get in place of their own (:mod:`envs.mjcf.recolour`); None leaves them.
    """

    name: str
    words: str
    rest: tuple[float, float, float, float]
    asset: str
    colour: str | None = None


@dataclass(frozen=True, slots=True)
class Entry:
    """One task: an object to grasp in the scene of a set.

    Attributes:
        set: One of :data:`SETS`.
        target: Name of the object to grasp.
    """

    set: str
    target: str

    @property
    def name(self) -> str:
        """Registered name: ``grasp/<set>/<object>``."""
        return f"{PREFIX}{self.set}/{self.target}"

    @property
    def class_name(self) -> str:
        """Name of the task's class."""
        return "Grasp" + "".join(word.capitalize() for word in f"{self.set}_{self.target}".split("_"))

    @property
    def instructions(self) -> tuple[str, ...]:
        """What to do: the paper's words first."""
        words = groceries()[self.target].words
        return tuple(form.format(words) for form in ("grasp the {}", "pick up the {}", "lift the {}"))


@cache
def groceries() -> dict[str, Grocery]:
    """Returns the objects by name: those of LIBERO, then those in another colour."""
    raw = json.loads(CATALOGUE.read_text(encoding="utf-8"))
    items = {
        name: Grocery(name, item["words"], tuple(item["rest"]), name) for name, item in raw["objects"].items()
    }
    for name, item in raw["coloured"].items():
        plain, colour = items[item["of"]], item["colour"]
        items[name] = replace(plain, name=name, words=f"{colour} {plain.words}", colour=colour)
    return items


@cache
def in_scene(set_name: str) -> tuple[str, ...]:
    """Returns the names of all objects in the scene of a set: those that tasks name, then the others."""
    one = json.loads(CATALOGUE.read_text(encoding="utf-8"))["sets"][set_name]
    return (*one["named"], *one["beside"])


@cache
def entries() -> dict[str, Entry]:
    """Returns registered name to task, by set and then by object."""
    raw = json.loads(CATALOGUE.read_text(encoding="utf-8"))["sets"]
    found = [Entry(name, target) for name in SETS for target in raw[name]["named"]]
    return {entry.name: entry for entry in found}

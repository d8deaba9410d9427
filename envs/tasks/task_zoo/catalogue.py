"""The goals of MultitaskKitchen (``multitask_kitchen.py``), one a ``task_id``. It imports nothing heavy."""

from dataclasses import dataclass
from functools import cache

PREFIX = "MultitaskKitchen"
HORIZON = 1000


@dataclass(frozen=True, kw_only=True, slots=True)
class Entry:
    """A goal and the start that the zoo gives it.

    Attributes:
        index: The zoo's ``task_id``.
        starts_on: The stove is on at the start.
        starts_open: The drawer is open at the start.
        starts_filled: The bread is in the pot at the start.
        closes: The drawer has to be shut.
        stove: Whether the stove has to be on or off; None where it does not matter.
        place: Where the pot has to be: ``stove`` or ``region``.
    """

    index: int
    starts_on: bool = False
    starts_open: bool = False
    starts_filled: bool = False
    closes: bool = False
    stove: bool | None = None
    place: str = "region"

    @property
    def name(self) -> str:
        """Registered name, and that of its class."""
        return f"{PREFIX}{self.index}"

    class_name = name

    @property
    def instructions(self) -> tuple[str, ...]:
        """What to do, in two wordings."""
        steps = []
        if self.closes and self.starts_open:
            steps.append(("close the drawer", "push the drawer shut"))
        if self.stove and not self.starts_on:
            steps.append(("turn on the stove", "push the lever over"))
        if not self.starts_filled:
            steps.append(("put the bread in the pot", "drop the bread into the pot"))
        goals = {
            "stove": ("place the pot on the stove", "set the pot on the burner"),
            "region": ("push the pot to the serving region", "push the pot onto the red plate"),
        }
        steps.append(goals[self.place])
        words = [[step[index] for step in steps] for index in (0, 1)]
        return tuple(" and ".join([", ".join(each[:-1]), each[-1]] if each[:-1] else each) for each in words)


_ALL = (
    Entry(index=0, starts_on=True, starts_open=True, closes=True, place="stove"),
    Entry(index=1, starts_open=True, starts_filled=True, closes=True, stove=False),
    Entry(index=2, stove=True),
    Entry(index=3, starts_on=True),
    Entry(index=4, starts_on=True, place="stove"),
    Entry(index=5, starts_on=True, starts_open=True, closes=True),
    Entry(index=6, stove=True, place="stove"),
    Entry(index=7, closes=True, stove=False),
    Entry(index=8, starts_open=True, closes=True, stove=False),
)


@cache
def entries() -> dict[str, Entry]:
    """Returns registered name to goal."""
    return {entry.name: entry for entry in _ALL}

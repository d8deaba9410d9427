"""Time of a command that does nothing: ``roboverse speed startup``."""

import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import partial

from roboverse_learn.speed.harness import Goal, Measurement, Settings, in_turns, measurement, program

TURNS = 5
GOAL = Goal(1.0, at_least=False, absolute=True)


def parts(_: Settings) -> Mapping[str, Callable[[], Measurement]]:
    """Returns the commands that are timed."""
    return {word: partial(startup, word) for word in ("list", "--help")}


def startup(word: str, turns: int = TURNS) -> Measurement:
    """Compares ``roboverse <word>`` to a Python program that ends at once."""
    ours, empty = (partial(_run, *words) for words in (("-m", "roboverse_learn.cli", word), ("-c", "")))
    return measurement(f"roboverse {word} / an empty Python program", in_turns(ours, empty, turns), GOAL)


def _run(*words: str) -> None:
    subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    sys.exit(program("startup", Settings, parts))

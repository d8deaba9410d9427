"""CALVIN's evaluation protocol: symbolic states of the table, and 1,000 chains of five instructions.

Rules and random numbers are those of ``mees/calvin`` (``calvin_agent/evaluation/multistep_sequences.py`` and
``utils.py``, MIT), so chains and starts are the authors'. Names of places are theirs, too: ``slider_right``
is the right half of the cabinet, and ``slider`` is where its door is.
"""

import json
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import permutations, product
from pathlib import Path

import numpy as np

from envs.tasks.calvin.catalogue import BLOCKS, task_facts

Symbols = Mapping[str, int | str]
"""``led`` and ``lightbulb`` 0 or 1, ``slider`` and ``drawer``, the place of each block, ``grasped``."""

Step = tuple[dict[str, int | str | tuple[str, ...]], dict[str, int | str]]
"""A condition, whose values may be alternatives, and an effect."""

Chain = tuple[dict[str, int | str], tuple[str, ...]]
"""The state in which it begins, and its tasks."""

CHAINS = Path(__file__).with_name("chains.json")

NUM_CHAINS, CHAIN_LENGTH, STEPS_PER_TASK = 1000, 5, 360

_BLOCKS = tuple(f"{colour}_block" for colour in BLOCKS)
_CABINET = ("slider_right", "slider_left")
_STATES = {
    "led": (0, 1),
    "lightbulb": (0, 1),
    "slider": ("right", "left"),
    "drawer": ("closed", "open"),
    "red_block": ("table", *_CABINET),
    "blue_block": ("table", *_CABINET),
    "pink_block": ("table", *_CABINET),
    "grasped": (0,),
}


def start_symbols() -> list[dict[str, int | str]]:
    """Returns the states in which chains begin: one or two blocks on the table, none twice in one place."""
    found = []
    for values in product(*_STATES.values()):
        counts = {place: values.count(place) for place in ("table", *_CABINET)}
        if counts["table"] in (1, 2) and max(counts["slider_right"], counts["slider_left"]) < 2:
            found.append(dict(zip(_STATES, values, strict=True)))
    return found


@cache
def steps_of(task: str) -> tuple[Step, ...]:
    """Returns the ways in which a task changes the symbolic state, each with its condition."""
    return tuple(_steps(task))


def _steps(task: str) -> Iterator[Step]:
    words = task.split("_")
    if task == "push_into_drawer":
        yield from _push_into_drawer()
    elif words[0] in ("stack", "unstack"):
        yield from _stack(words[0] == "stack")
    elif words[0] == "lift":
        yield from _lift(f"{words[1]}_block", words[3])
    elif words[0] == "place":
        yield from _place(words[2])
    else:
        yield _one_step(words)


def _one_step(words: list[str]) -> Step:
    """Returns the condition and the effect of a task that has one way."""
    free = {"grasped": 0}
    if words[0] == "move":
        to = words[2]
        return {"slider": "left" if to == "right" else "right", **free}, {"slider": to}
    if words[1] == "drawer":
        before, end = ("closed", "open") if words[0] == "open" else ("open", "closed")
        return {"drawer": before, **free}, {"drawer": end}
    if words[0] == "turn":
        light, on = words[2], int(words[1] == "on")
        return {light: 1 - on, **free}, {light: on}
    block = f"{words[1]}_block"
    return {block: "table", **free}, {block: "table"}


def _lift(block: str, place: str) -> Iterator[Step]:
    held = {block: "grasped", "grasped": 1}
    if place == "slider":
        for side, door in (("left", "right"), ("right", "left")):
            yield {block: f"slider_{side}", "slider": door, "grasped": 0}, held
    elif place == "drawer":
        yield {block: place, "drawer": "open", "grasped": 0}, held
    else:
        yield {block: place, "grasped": 0}, held


def _place(place: str) -> Iterator[Step]:
    for block in _BLOCKS:
        held = {block: "grasped", "grasped": 1}
        if place == "drawer":
            yield {**held, "drawer": "open"}, {block: "drawer", "grasped": 0}
        else:
            for door in ("right", "left"):
                yield {**held, "slider": door}, {block: f"slider_{door}", "grasped": 0}


def _stack(stacks: bool) -> Iterator[Step]:
    for top, bottom in permutations(_BLOCKS, 2):
        stacked = {top: "stacked_top", bottom: "stacked_bottom", "grasped": 0}
        if stacks:
            yield {top: "grasped", bottom: "table", "grasped": 1}, stacked
        else:
            yield stacked, {top: "table", bottom: "table"}


def _push_into_drawer() -> Iterator[Step]:
    for block in _BLOCKS:
        others = {other: _CABINET for other in _BLOCKS if other != block}
        yield {block: "table", **others, "drawer": "open", "grasped": 0}, {block: "drawer", "grasped": 0}


def holds(symbols: Symbols, condition: Mapping[str, int | str | tuple[str, ...]]) -> bool:
    """Returns whether a symbolic state meets a condition."""
    return all(
        symbols[key] in value if isinstance(value, tuple) else symbols[key] == value
        for key, value in condition.items()
    )


def after(symbols: Symbols, task: str) -> list[dict[str, int | str]]:
    """Returns the states that a task can lead to; none where it cannot be done."""
    return [{**symbols, **effect} for condition, effect in steps_of(task) if holds(symbols, condition)]


def chain_is_valid(symbols: Symbols, chain: tuple[str, ...]) -> bool:
    """Returns whether tasks can follow each other, each in one way, no two of one category."""
    for task in chain:
        states = after(symbols, task)
        if len(states) != 1:
            return False
        symbols = states[0]
    categories = [task_facts()[task].category for task in chain]
    return len(set(categories)) == len(categories)


def chains_from(symbols: Symbols, count: int, seed: int) -> list[tuple[str, ...]]:
    """Returns chains that begin in a state, drawn as the authors draw them."""
    rng, names = np.random.RandomState(seed), list(task_facts())
    found: list[tuple[str, ...]] = []
    while len(found) < count:
        chain = tuple(rng.choice(names, size=CHAIN_LENGTH, replace=False).tolist())
        if chain_is_valid(symbols, chain):
            found.append(chain)
    return found


def drawn_chains() -> list[Chain]:
    """Draws the protocol's chains by the authors' rule, which takes a minute."""
    starts = start_symbols()
    shares = [len(part) for part in np.array_split(range(NUM_CHAINS), len(starts))]
    found = [
        (start, chain)
        for seed, (start, share) in enumerate(zip(starts, shares, strict=True))
        for chain in chains_from(start, share, seed)
    ]
    order = np.arange(len(found))
    np.random.RandomState(0).shuffle(order)
    return [found[index] for index in order]


@cache
def all_chains() -> tuple[Chain, ...]:
    """Returns the protocol's 1,000 chains: the state in which each begins, and its tasks.

    ``chains.json`` has them as :func:`drawn_chains` gives them: the index of the start among
    :func:`start_symbols`, then the indices of the tasks.
    """
    starts, names = start_symbols(), list(task_facts())
    rows = json.loads(CHAINS.read_text(encoding="utf-8"))
    return tuple((starts[start], tuple(names[task] for task in tasks)) for start, *tasks in rows)


def start_seed(symbols: Symbols) -> int:
    """Returns the seed of a state's start: a hash of how Python prints the state's values."""
    return fnv1(f"dict_values({list(symbols.values())!r})")


def fnv1(text: str) -> int:
    """Returns the 32-bit FNV-1 hash from 0 of a text: ``pyhash.fnv1_32()``, by which the authors seed."""
    value = 0
    for byte in text.encode():
        value = (value * 0x01000193) & 0xFFFFFFFF ^ byte
    return value

"""CALVIN's symbolic states and chains, against facts of the authors' code."""

import numpy as np
import pytest

from envs.tasks.calvin.catalogue import task_facts
from envs.tasks.calvin.sequences import (
    after,
    all_chains,
    chain_is_valid,
    chains_from,
    drawn_chains,
    fnv1,
    start_seed,
    start_symbols,
    steps_of,
)

START = {
    "led": 1,
    "lightbulb": 1,
    "slider": "left",
    "drawer": "open",
    "red_block": "slider_left",
    "blue_block": "table",
    "pink_block": "slider_right",
    "grasped": 0,
}


FIRST_CHAIN = [
    ("open_drawer", "turn_on_lightbulb", "move_slider_left", "rotate_red_block_left", "lift_red_block_table")
]
"""Of the first of the 192 states, by the authors' ``get_sequences_for_state2``."""


def test_there_are_34_tasks_in_11_categories_and_192_starts():
    assert len(task_facts()) == 34
    assert len({facts.category for facts in task_facts().values()}) == 11
    assert len(start_symbols()) == 192
    assert START in start_symbols()


def test_no_start_has_two_blocks_in_one_half_of_the_cabinet():
    for symbols in start_symbols():
        places = [symbols[f"{colour}_block"] for colour in ("red", "blue", "pink")]
        assert places.count("table") in (1, 2)
        assert places.count("slider_left") < 2
        assert places.count("slider_right") < 2


@pytest.mark.parametrize(
    ("task", "ways"),
    [("stack_block", 6), ("place_in_slider", 6), ("lift_red_block_slider", 2), ("open_drawer", 1)],
)
def test_a_task_has_as_many_ways_as_the_authors_list(task, ways):
    assert len(steps_of(task)) == ways


def test_effects_follow_from_conditions():
    assert after(START, "open_drawer") == []
    assert after(START, "close_drawer")[0]["drawer"] == "closed"
    assert after(START, "lift_red_block_slider") == []  # its half is behind the door
    held = after(START, "lift_pink_block_slider")[0]
    assert held["pink_block"] == "grasped"
    assert after(held, "place_in_drawer")[0] == {**START, "pink_block": "drawer"}
    assert after(held, "turn_on_led") == []


def test_a_chain_of_two_tasks_of_one_category_is_none():
    tasks = ("turn_off_led", "close_drawer", "move_slider_right")
    assert chain_is_valid(START, tasks)
    assert not chain_is_valid(START, (*tasks, "turn_off_lightbulb"))


def test_chains_from_a_start_are_the_authors():
    first = start_symbols()[0]
    assert chains_from(first, 1, 0) == FIRST_CHAIN
    assert all(chain_is_valid(first, chain) for chain in chains_from(first, 2, 7))


def test_the_protocols_chains_are_kept_in_the_package_and_valid():
    chains = all_chains()
    assert len(chains) == 1000
    assert all(chain_is_valid(symbols, chain) for symbols, chain in chains)
    counts = np.unique([str(sorted(symbols.items())) for symbols, _ in chains], return_counts=True)[1]
    assert len(counts) == 192
    assert set(counts.tolist()) == {5, 6}


@pytest.mark.long
def test_the_kept_chains_are_those_that_the_authors_rule_draws():
    assert drawn_chains() == list(all_chains())


@pytest.mark.slow
def test_the_protocols_chains_are_drawn_by_the_authors_rule():
    shares = [len(part) for part in np.array_split(range(1000), 192)]
    for seed in (0, 100):  # drawing those of all 192 starts takes minutes
        start = start_symbols()[seed]
        drawn = [tuple(chain) for chain in chains_from(start, shares[seed], seed)]
        assert sorted(drawn) == sorted(tuple(chain) for symbols, chain in all_chains() if symbols == start)


def test_the_seed_of_a_start_is_pyhashs_fnv1():
    assert fnv1("hello world") == 2805756500  # the example of pyhash's documentation
    values = "dict_values([1, 1, 'left', 'open', 'slider_left', 'table', 'slider_right', 0])"
    assert start_seed(START) == fnv1(values)

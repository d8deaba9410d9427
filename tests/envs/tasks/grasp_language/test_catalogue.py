"""Names, words and sets of grasping by language."""

from collections import Counter

import pytest

from envs.mjcf.recolour import COLOUR_HUES_DEG
from envs.tasks import TASKS
from envs.tasks.grasp_language.catalogue import SETS, entries, groceries, in_scene
from envs.tasks.suites import suite_tasks


def test_every_task_is_registered_with_its_words():
    for name, entry in entries().items():
        assert name == f"grasp/{entry.set}/{entry.target}"
        assert TASKS.entry(name).summary.startswith(f"grasp the {groceries()[entry.target].words}, one of")
    sizes = {"few": 5, "many": 10, "unseen": 7, "colours": 30}
    assert {name: len(suite_tasks(f"grasp/{name}")) for name in sizes} == sizes


def test_few_are_among_many_and_unseen_are_in_neither():
    named = {name: {entry.target for entry in entries().values() if entry.set == name} for name in SETS}
    assert named["few"] < named["many"]
    assert not named["unseen"] & set(in_scene("many"))
    assert set(in_scene("unseen")) - named["unseen"] <= named["many"], "what lies beside them is known"


@pytest.mark.parametrize("name", ["colours_1", "colours_2", "colours_3"])
def test_in_a_scene_of_colours_neither_noun_nor_colour_alone_says_what_is_meant(name):
    items = [groceries()[each] for each in in_scene(name)]
    assert len(items) == 10
    assert min(Counter(item.asset for item in items).values()) >= 2
    assert min(Counter(item.colour for item in items).values()) >= 2, "with no colour too: those of LIBERO"


def test_colours_name_the_colour_and_the_noun_of_each_recoloured_unseen_but_never_both_together():
    shown = {name for each in SETS if each != "unseen" for name in in_scene(each)}
    others = [groceries()[each] for each in shown if groceries()[each].colour]
    for name in ("green_butter", "green_ketchup", "red_orange_juice", "yellow_milk"):
        assert name in in_scene("unseen") and name not in shown
        colour, noun = name.split("_", 1)
        assert sum(item.colour == colour for item in others) >= 4
        assert sum(item.asset == noun for item in others) >= 2 and noun in shown
        assert not any((item.colour, item.asset) == (colour, noun) for item in others)


def test_an_object_in_another_colour_stands_like_the_one_of_libero():
    blue, plain = groceries()["blue_ketchup"], groceries()["ketchup"]
    assert (blue.asset, blue.colour, blue.words, blue.rest) == ("ketchup", "blue", "blue ketchup", plain.rest)
    assert all(item.colour in (None, *COLOUR_HUES_DEG) for item in groceries().values())
    assert plain.colour is None


def test_no_two_objects_have_the_same_words_and_all_have_unit_quaternions():
    items = groceries().values()
    assert len({item.words for item in items}) == len(items)
    assert all(abs(sum(part**2 for part in item.rest) - 1.0) < 1e-6 for item in items)
    assert {name for each in SETS for name in in_scene(each)} == set(groceries())

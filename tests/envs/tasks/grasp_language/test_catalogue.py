"""Names, words and sets of grasping by language."""

from envs.tasks import TASKS
from envs.tasks.grasp_language.catalogue import SETS, entries, groceries, in_scene
from envs.tasks.suites import suite_tasks


def test_every_task_is_registered_with_its_words():
    for name, entry in entries().items():
        assert name == f"grasp/{entry.set}/{entry.target}"
        assert TASKS.entry(name).summary.startswith(f"grasp the {groceries()[entry.target].words}, one of")
    assert [len(suite_tasks(f"grasp/{name}")) for name in SETS] == [5, 10, 7]


def test_few_are_among_many_and_unseen_are_in_neither():
    named = {name: {entry.target for entry in entries().values() if entry.set == name} for name in SETS}
    assert named["few"] < named["many"]
    assert not named["unseen"] & set(in_scene("many"))
    assert set(in_scene("unseen")) - named["unseen"] <= named["many"], "what lies beside them is known"


def test_no_two_objects_have_the_same_words_and_all_have_unit_quaternions():
    items = groceries().values()
    assert len({item.words for item in items}) == len(items)
    assert all(abs(sum(part**2 for part in item.rest) - 1.0) < 1e-6 for item in items)
    assert {name for each in SETS for name in in_scene(each)} == set(groceries())

"""Instructions that are wrong in a scene."""

from dataclasses import dataclass
from typing import ClassVar

import pytest

from envs.core.errors import ConfigError
from envs.randomization.language import load_grammar
from envs.tasks import TASKS
from envs.tasks.pick_cube import PickCube
from envs.tasks.wrong_instructions import wrong_instructions


@pytest.fixture
def registry(monkeypatch):
    """The registry, without what a test adds once it ends."""
    monkeypatch.setattr(TASKS, "_entries", dict(TASKS._entries))
    return TASKS


@pytest.mark.parametrize("name", [name for name in TASKS if "benchmark" in TASKS.entry(name).tags])
def test_every_task_of_the_benchmark_has_wrong_ones_that_mean_something_else(name):
    task, grammar = TASKS.get(name)(), load_grammar()
    wrong = wrong_instructions(task)
    assert len(wrong) >= 2 and not {*wrong} & {*task.instructions}
    for other, own in ((grammar.meaning(a), grammar.meaning(b)) for a in wrong for b in task.instructions):
        assert not (other["verbs"] & own["verbs"] and other["nouns"] & own["nouns"])


def test_a_task_of_the_benchmark_takes_words_of_the_others():
    others = [name for name in TASKS if "benchmark" in TASKS.entry(name).tags and name != "PickCube"]
    assert {*wrong_instructions(PickCube())} <= {TASKS.get(name).instructions[0] for name in others}
    assert "close the box" in wrong_instructions(PickCube())


def test_another_task_takes_words_of_its_origin():
    wrong = wrong_instructions(TASKS.get("PushCube")())
    assert {"plug the charger into the receptacle", "pull the blue cube onto the target"} & {*wrong}
    assert "close the box" not in wrong


@dataclass(frozen=True, kw_only=True)
class InOneScene(PickCube):
    """A task that names another one of its scene."""

    name: ClassVar[str] = "InOneScene"

    def same_scene_tasks(self):
        return ("Lift",)


def test_a_task_of_the_same_scene_is_taken_whatever_its_words():
    assert wrong_instructions(InOneScene()) == (TASKS.get("Lift").instructions[0],)


def test_where_nothing_else_is_registered_there_is_no_wrong_one(registry, monkeypatch):
    monkeypatch.setattr(registry, "_entries", {"PickCube": registry.entry("PickCube")})
    monkeypatch.setattr(registry, "_complete", True)
    with pytest.raises(ConfigError, match="No registered task asks for something else than PickCube"):
        wrong_instructions(PickCube())

"""Wordings of a task's bank beside those of its demonstrations."""

import pytest

from envs.core.errors import PolicyError
from envs.spec import EnvSpec
from policies.learned_tasks import Instructions, LearnedTask
from policies.mtact.config import MtActConfig
from roboverse_learn.training.imitation.wordings import with_bank_wordings


def test_known_wordings_alone_are_added_and_indices_of_the_demonstrations_stay():
    tasks = tuple(
        LearnedTask(name=name, state_size=9, action_size=9) for name in ("PickCube", "mine", "CloseBox")
    )
    own = Instructions(texts=("lift it", "do mine", "shut it"), tasks=tasks, task_of=(0, 1, 2))
    found = with_bank_wordings(own)
    assert found.texts[:3] == own.texts and found.task_of[:3] == own.task_of and found.tasks == tasks
    assert found.task_of.count(1) == 1
    assert len(set(found.texts)) == len(found.texts)
    for number, name in ((0, "PickCube"), (2, "CloseBox")):
        task = EnvSpec(task=name).make_task()
        bank = task.wordings(task.description)
        added = {text for text, of in zip(found.texts[3:], found.task_of[3:], strict=True) if of == number}
        assert added == set(bank.known) and len(added) > 100
        assert not added & {*bank.new_frame, *bank.new_words}


def test_a_bank_without_swapping_is_an_error():
    with pytest.raises(PolicyError, match=r"needs policy\.swap_wordings=true"):
        MtActConfig(bank_wordings=True)

"""Banks of wordings: the same everywhere, 90/10, and nothing held out occurs in training."""

import re

import pytest

from envs.core.errors import ConfigError, MissingExtraError, UnknownNameError
from envs.randomization.language import KINDS, WordingBank, bank_of, load_grammar
from envs.tasks import TASKS
from envs.tasks.libero.catalogue import entries
from envs.tasks.metaworld.catalogue import PREFIX, WORDS

FROZEN = {
    "PickCube": "76cc1e55bf50a756",
    "CloseBox": "8b457f3585537871",
    "humanoid/run": "977c8e838c6c75fe",
    "libero/goal/open_the_middle_drawer_of_the_cabinet": "397f46f261e6712c",
}
"""Task to the digest of its bank."""


def all_instructions():
    """Returns the instructions of every registered task, also of those whose extra is not installed."""
    found = {name: (entry.instruction,) for name, entry in entries().items()}
    found |= {PREFIX + name: words for name, words in WORDS.items()}
    for name in TASKS:
        if name not in found:
            try:
                found[name] = TASKS.get(name).instructions
            except MissingExtraError:
                continue
    return found


@pytest.fixture(scope="module")
def banks():
    return {name: bank_of(words) for name, words in all_instructions().items()}


def words(text):
    return set(re.findall(r"[\w'-]+", text))


def test_banks_are_frozen(banks):
    assert {name: banks[name].digest for name in FROZEN} == FROZEN


def test_a_bank_is_the_same_every_time():
    instructions = TASKS.get("StackCube").instructions
    assert bank_of.__wrapped__(instructions) == bank_of.__wrapped__(instructions)


def test_a_tenth_of_every_bank_is_held_out_in_both_kinds(banks):
    for name, bank in banks.items():
        share = len(bank.test) / (len(bank.known) + len(bank.test))
        assert 0.09 < share < 0.11, name
        assert bank.new_frame and {*all_instructions()[name]} <= {*bank.known}, name
    assert len(banks["PickCube"].known) == 180
    assert len(banks["PickCube"].new_frame) == len(banks["PickCube"].new_words) == 10


def test_no_test_wording_is_in_a_train_split_of_any_task(banks):
    train = {wording for bank in banks.values() for wording in bank.known}
    leaked = [wording for bank in banks.values() for wording in bank.test if wording in train]
    assert not leaked


def test_new_words_are_in_no_train_wording_of_a_task_of_their_source(banks):
    """Sources differ in words (CALVIN says "rotate"), and one frozen grammar serves them all."""
    sources = {}
    for name, bank in banks.items():
        sources.setdefault(name.rpartition("/")[0].partition("/")[0], {})[name] = bank
    assert len(sources) >= 5
    for own in sources.values():
        known = set().union(*(words(text) for bank in own.values() for text in bank.known))
        for name, bank in own.items():
            assert all(words(text) - known for text in bank.new_words), name
            assert all(words(text) <= known for text in bank.new_frame), name


def test_new_words_are_in_known_frames_and_known_words_in_new_frames(banks):
    frames = load_grammar().train_frames
    patterns = [re.compile(re.escape(frame).replace(r"\{x\}", "(.+)")) for frame in frames if frame != "{x}"]
    for text in banks["PickCube"].new_frame:
        assert text.startswith(("could you try to", "robot i need", "hey i would like", "your next task is"))
    framed = [text for text in banks["StackCube"].new_words if any(p.fullmatch(text) for p in patterns)]
    assert len(framed) >= 5, "the rest is the sentence alone"


def test_an_instruction_of_unknown_words_has_new_frames_alone():
    bank = bank_of(("frobnicate the gizmo",))
    assert len(bank.known) == 36 and "please frobnicate the gizmo" in bank.known
    assert len(bank.new_frame) == 4 and bank.new_words == ()


def test_a_sentence_of_prose_is_reworded_inside_the_frames():
    bank = bank_of(("Pick up the cube.",))
    assert bank.known[0] == "Pick up the cube."
    assert all(text == bank.known[0] or not re.search(r"[A-Z.]", text) for text in bank.known)


def test_a_word_of_the_own_instruction_is_never_a_new_word():
    bank = bank_of(("put the cube on the brick", "stack the cube"))
    assert any("brick" in text for text in bank.known)
    assert not any("the brick" in text and "brick on the" in text for text in bank.new_words)
    assert not any("stack the brick" in text for text in bank.new_words)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((("a",),), "needs a known and a held-out one; given 1 known and 0 held out"),
        (((), ("a",)), "given 0 known and 1 held out"),
        ((("a", "b"), ("b",)), "has 'b' twice. A wording is either known or held out"),
    ],
)
def test_an_impossible_bank_is_an_error(arguments, message):
    with pytest.raises(ConfigError, match=message):
        WordingBank(*arguments)


def test_kinds_and_splits_of_a_bank_of_ones_own():
    bank = WordingBank(("go",), ("do go",), ("leave",))
    assert (bank.of("train"), bank.of("test")) == (("go",), ("do go", "leave"))
    assert [bank.kind(text) for text in ("go", "do go", "leave")] == [*KINDS]
    with pytest.raises(UnknownNameError, match=r"kind of wording 'new_word'.*Did you mean 'new_words'"):
        bank.of_kind("new_word")
    with pytest.raises(UnknownNameError, match="split 'val'"):
        bank.of("val")
    with pytest.raises(UnknownNameError, match="wording 'gone'"):
        bank.kind("gone")

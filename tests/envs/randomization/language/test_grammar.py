"""The frozen grammar: frames and synonyms, and what is held out of them."""

import json
import re

import pytest

from envs.core.errors import ConfigError
from envs.randomization.language import grammar, load_grammar

FROZEN = "8e7b7c749c3ae789788044ab8c30dd680081675afab77fe730f8431d84a9ad1a"
"""Results of the channel ``language`` hold for this content; other words are another version."""


def words(text):
    return set(re.findall(r"[\w'-]+", text))


def test_the_grammar_is_frozen():
    assert (load_grammar().version, load_grammar().digest) == ("v1", FROZEN)


def test_a_changed_file_is_an_error(monkeypatch, tmp_path):
    content = json.loads((grammar.FOLDER / "v1.json").read_text())
    content["frames"]["train"].append("kindly {x}")
    (tmp_path / "v9.json").write_text(json.dumps(content))
    monkeypatch.setattr(grammar, "FOLDER", tmp_path)
    with pytest.raises(ConfigError, match="was changed: its content has SHA-256"):
        load_grammar("v9")


def test_a_tenth_of_the_frames_is_held_out_and_made_of_known_words():
    own = load_grammar()
    assert len(own.test_frames) * 9 == len(own.train_frames)
    assert not {*own.test_frames} & {*own.train_frames}
    known = set().union(*map(words, own.train_frames))
    assert set().union(*map(words, own.test_frames)) <= known


def test_no_phrase_belongs_to_two_groups():
    phrases = [phrase for group in load_grammar().synonyms for phrase in group.match]
    assert len(phrases) == len(set(phrases))


def test_a_template_by_hand():
    """Two verbs and two nouns; the second 'cube' is the first slot again, 'one' is no phrase."""
    template = load_grammar().template("stack the cube on the cube and push the lid")
    assert template.pieces == ("", 0, " the ", 1, " on the ", 1, " and ", 2, " the ", 3, "")
    assert [slot.phrase for slot in template.slots] == ["stack", "cube", "push", "lid"]
    assert [slot.known for slot in template.slots] == [
        ("stack",),
        ("cube", "block"),
        ("push", "shove"),
        ("lid", "cover"),
    ]
    assert [slot.new for slot in template.slots] == [("pile",), ("brick",), ("nudge",), ("flap",)]
    assert (template.count(new=False), template.count(new=True)) == (8, 2 * 3 * 3 * 3)
    assert template.sentence(0, new=False) == ("stack the cube on the cube and push the lid", False)
    assert template.sentence(1, new=True) == ("pile the cube on the cube and push the lid", True)
    assert template.sentence(7, new=False) == ("stack the block on the block and shove the cover", False)


def test_two_kinds_of_objects_never_get_one_name():
    template = load_grammar().template("push the cube past the block")
    assert [slot.known for slot in template.slots[1:]] == [("cube",), ("block",)]


def test_a_word_that_means_something_else_stays():
    assert load_grammar().template("pick the puck up").slots == ()
    assert [slot.phrase for slot in load_grammar().template("put the plug into the wall socket").slots] == [
        "put"
    ]


def test_meanings_are_equal_for_synonyms():
    own = load_grammar()
    assert own.meaning("push the block") == own.meaning("push the cube")
    assert own.meaning("push the block") != own.meaning("pull the block")

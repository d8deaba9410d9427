from typing import Any

import pytest

from benchmark.protocol import Cell, Protocol
from envs.core.errors import ConfigError, RoboVerseError


def test_default_protocol_is_four_levels_on_both_splits():
    cells = Protocol().cells()
    assert len(cells) == 8
    assert cells[0] == Cell(level=0, split="train")
    assert cells[-1] == Cell(level=3, split="test")


def test_channels_alone_follow_the_levels():
    cells = Protocol(levels=(0,), only=("camera",), splits=("test",)).cells()
    assert [str(cell) for cell in cells] == ["level 0, test split", "camera alone, test split"]
    assert [cell.name for cell in cells] == ["level0-test", "camera-test"]


def test_hash_is_frozen():
    """A published result names this hash: it must never change without a new version."""
    assert Protocol().hash == "c6012a92950285f8"


def test_hash_follows_every_field():
    changes: tuple[dict[str, Any], ...] = (
        {"levels": (0,)},
        {"only": ("camera",)},
        {"splits": ("test",)},
        {"episodes": 20},
        {"seed": 1},
        {"width": 0.1},
        {"instructions": ("wrong",)},
    )
    hashes = {Protocol().hash} | {Protocol(**change).hash for change in changes}
    assert len(hashes) == 1 + len(changes)


def test_json_round_trip():
    protocol = Protocol(levels=(0, 3), only=("lighting",), episodes=7, seed=5)
    assert Protocol.from_json(protocol.to_json()) == protocol


def test_a_width_is_written_only_where_there_is_one():
    assert "width" not in Protocol().to_json()
    protocol = Protocol(width=0.1)
    assert Protocol.from_json(protocol.to_json()) == protocol
    with pytest.raises(ConfigError, match=r"width must be between 0 and 1, given 10: 0\.1 ends a cell"):
        Protocol(width=10)


def test_episodes_are_the_first_of_the_split():
    assert Protocol(episodes=3).episodes_of([9, 4, 7, 1]) == [9, 4, 7]
    with pytest.raises(ConfigError, match=r"100 episodes .* the split has 4\. Set episodes to at most 4"):
        Protocol().episodes_of([9, 4, 7, 1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"levels": (4,)}, "Unknown level 4. Valid: 0, 1, 2, 3."),
        ({"levels": (0, 0)}, "levels must differ from each other"),
        ({"levels": ()}, "has no cells"),
        ({"splits": ("tests",)}, "Unknown split 'tests'. Did you mean 'test'?"),
        ({"only": ("cameras",)}, "Unknown channel 'cameras'. Did you mean 'camera'?"),
        ({"episodes": 0}, "episodes must be a whole number of at least 1, given 0"),
        ({"episodes": True}, "episodes must be a whole number"),
        ({"seed": -1}, "seed must be a whole number of at least 0"),
        ({"version": "v9"}, "Unknown protocol version 'v9'. This release evaluates 'v2'"),
    ],
)
def test_bad_values_are_named(change, message):
    with pytest.raises(RoboVerseError) as caught:
        Protocol(**change)
    assert message in str(caught.value)


def test_a_cell_is_a_level_or_a_channel():
    with pytest.raises(ConfigError, match="a level or one channel alone"):
        Cell(level=1, only="camera", split="test")
    with pytest.raises(ConfigError, match="a level or one channel alone"):
        Cell(split="test")


def test_instruction_tests_follow_on_the_episodes_of_level_0():
    protocol = Protocol(
        levels=(0, 3), only=("camera",), splits=("test",), instructions=("new_words", "wrong")
    )
    assert [cell.name for cell in protocol.cells()] == [
        "level0-test",
        "level3-test",
        "camera-test",
        "instruction_new_words-test",
        "instruction_wrong-test",
    ]
    *_, new_words, wrong = protocol.cells()
    assert str(new_words) == "instruction new words, test split"
    assert wrong.right == Cell(level=0, split="test")
    assert Protocol.from_json(protocol.to_json()) == protocol


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"instructions": ("rong",)}, r"instruction test 'rong'.*Did you mean 'wrong'"),
        ({"instructions": ("wrong",), "levels": (1,)}, r"which is level 0; add it: levels=\[0,1\]\."),
        ({"instructions": ("wrong",), "width": 0.1}, r"compared episode by episode, and width=0.1"),
        ({"instructions": ("wrong", "wrong")}, r"instructions must differ from each other"),
    ],
)
def test_instruction_tests_that_cannot_be_compared_are_errors(arguments, message):
    with pytest.raises(RoboVerseError, match=message):
        Protocol(**arguments)


def test_a_cell_tests_instructions_at_level_0_alone():
    with pytest.raises(ConfigError, match=r"Instructions are tested at level 0; given level=2"):
        Cell(level=2, split="test", instruction_test="wrong")

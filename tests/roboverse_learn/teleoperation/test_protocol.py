import contextlib
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roboverse_learn.teleoperation.protocol import (
    Button,
    Join,
    Move,
    Press,
    ProtocolError,
    View,
    parse,
)


def text(**message):
    return json.dumps(message)


def test_messages_are_read():
    assert parse(text(type="join", client="ab", operator=" Ada ")) == Join(client="ab", operator="Ada")
    assert parse(text(type="press", button="undo")) == Press(button=Button.UNDO)
    assert parse(text(type="view", cameras=["front", "wrist", "front"])) == View(cameras=("front", "wrist"))
    move = text(type="move", seq=3, rate=[0, 0, 1, 0, 0, 0], gripper=-1, device="gamepad", seen=2)
    assert parse(move) == Move(seq=3, rate=(0, 0, 1, 0, 0, 0), gripper=-1, device="gamepad", seen=2)
    assert parse(move).moves and not parse(text(type="move")).moves


def test_motions_are_clipped_to_what_a_step_may_do():
    move = parse(text(type="move", rate=[9, -9, 0.5, 0, 0, 0], shift=[1, 0, 0, -7, 0, 0], gripper=5))
    assert move.rate == (1.0, -1.0, 0.5, 0.0, 0.0, 0.0)
    assert move.shift == (0.1, 0.0, 0.0, -0.5, 0.0, 0.0)
    assert move.gripper == 1.0


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ("", "JSON object"),
        ("[" * 2000, "JSON object"),
        ("[1]", "JSON object"),
        ("null", "JSON object"),
        (text(type="steal"), "Unknown type of message. Valid: join, move, press, view"),
        (text(type=["move"]), "Unknown type"),
        (text(type="move", rate=[0] * 5), "rate must be a list of 6 numbers"),
        (text(type="move", rate="000000"), "rate must be a list"),
        (text(type="move", rate=[True] + [0] * 5), "finite numbers"),
        ('{"type":"move","rate":[1e999,0,0,0,0,0]}', "finite numbers"),
        ('{"type":"move","rate":[NaN,0,0,0,0,0]}', "JSON object"),
        ('{"type":"move","shift":[' + "9" * 400 + ",0,0,0,0,0]}", "finite numbers"),
        (text(type="move", seq=-1), "seq must be a whole number"),
        (text(type="move", seq=1.5), "seq must be a whole number"),
        (text(type="move", device="rocket"), "Unknown device. Valid: keyboard"),
        (text(type="move", gripper=[1]), "gripper must hold finite numbers"),
        (text(type="move", run="rm"), "Unknown field 'run'. Valid: seq"),
        (text(type="press", button="explode"), "Unknown button. Valid: start"),
        (text(type="press", button=["start"]), "Unknown button"),
        (text(type="join"), "join needs a client"),
        (text(type="join", client="a" * 41), "at most 40"),
        (text(type="join", client="a\nb"), "printable"),
        (text(type="view", cameras=[]), "list of 1 to 4 names"),
        (text(type="view", cameras=[3]), "camera must be a text"),
    ],
)
def test_other_messages_are_refused(message, words):
    with pytest.raises(ProtocolError, match=words):
        parse(message)


@settings(max_examples=40, deadline=None)
@given(st.text(max_size=200) | st.recursive(st.none() | st.floats() | st.text(), st.lists).map(json.dumps))
def test_any_text_is_a_message_or_a_protocol_error(message):
    with contextlib.suppress(ProtocolError):
        parse(message)


VALUES = st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5), st.lists)


@settings(max_examples=40, deadline=None)
@given(st.dictionaries(st.sampled_from(["seq", "rate", "shift", "gripper", "device", "seen"]), VALUES))
def test_a_move_that_is_read_is_within_its_bounds(fields):
    try:
        move = parse(json.dumps({"type": "move", **fields}))
    except ProtocolError:
        return
    assert all(abs(value) <= 1.0 for value in move.rate)
    assert all(abs(value) <= limit for value, limit in zip(move.shift, [0.1] * 3 + [0.5] * 3, strict=True))
    assert move.gripper is None or abs(move.gripper) <= 1.0

"""What is said of a value that Hydra cannot read, or reads as several."""

import re

import pytest

from envs.core.errors import ConfigError
from roboverse_learn.config.compose import compose
from roboverse_learn.config.grammar import UNKNOWN, check_value
from roboverse_learn.sweep import plan

A_VALUE = (
    "a value is a number, a word, true, false, null, a list such as [1,2], or keys such as {a:1,b:2}; any "
    "other text stands in quotes."
)


@pytest.mark.parametrize(
    ("word", "default", "said"),
    [
        ("n=[1,2", 8, "the [ is not closed. n takes one value, such as n=8."),
        ("n=1]", 8, "the ] closes nothing. n takes one value, such as n=8."),
        ("n=tru,", False, f"{A_VALUE} n takes one value, such as n=false."),
        ("only=[", None, "the [ is not closed. only takes one value."),
        ("names=[a,b", [], "the [ is not closed. Write names=[a,b]."),
        ("names=a]", [], "the ] closes nothing. Write names=a."),
        ("names=a,b]", [], "the ] closes nothing. Write names=[a,b]."),
        ("pos=[1,2,3]]", UNKNOWN, "the ] closes nothing. Write pos=[1,2,3]."),
        ("pos=(1,2,3)", UNKNOWN, f"{A_VALUE} Write pos=[1,2,3]."),
        ("pos=[1;2]", UNKNOWN, f"{A_VALUE} Give one value, or a list in brackets."),
        ("physics={decimation:5", UNKNOWN, "the { is not closed. Write physics={decimation:5}."),
        (
            "geoms=[{size:[1,2}]",
            UNKNOWN,
            "the [ is not closed before the }. Give one value, or a list in brackets.",
        ),
        ("mjcf='it\\'s", UNKNOWN, "the ' is not closed. Write mjcf='it\\'s'."),
        ("mjcf='[a]", UNKNOWN, "the ' is not closed. Write mjcf='[a]'."),
    ],
)
def test_what_cannot_be_read_is_told_with_what_to_write(word: str, default: object, said: str) -> None:
    with pytest.raises(ConfigError, match=f"^{re.escape(f"'{word}' cannot be read: {said}")}$"):
        check_value(word, "collect", default)


@pytest.mark.parametrize(
    ("word", "default", "said"),
    [
        ("pos=1.2,0,0.8", UNKNOWN, "If a list is meant, write pos=[1.2,0,0.8]."),
        ("names=a,b", [], "Write names=[a,b]."),
        ("level=0,1", 0, "level takes one value, such as level=0."),
        ("level=range(3)", 0, "level takes one value, such as level=0."),
        ("pos=[1,2],[3,4]", UNKNOWN, "Give one value, or a list in brackets."),
    ],
)
def test_several_values_are_no_value(word: str, default: object, said: str) -> None:
    several = re.escape(f"'{word}' gives several values. {said}")
    with pytest.raises(ConfigError, match=f"^{several}$"):
        check_value(word, "collect", default)
    with pytest.raises(ConfigError, match=f"^{several} For a run with each of them: roboverse sweep "):
        check_value(word, "train", default)


def test_keys_are_no_value_where_one_is_meant() -> None:
    with pytest.raises(
        ConfigError, match=r"^'n=\{a:1\}' gives keys of its own\. n takes one value, such as n=8"
    ):
        check_value("n={a:1}", "collect", 8)
    with pytest.raises(ConfigError, match=r"^'n=\{a:1\}' gives keys of its own\. Give one value, or a list"):
        check_value("n={a:1}", "collect", [])
    check_value("n={a:1}", "collect", UNKNOWN)


@pytest.mark.parametrize("value", ["1", "", "a b", "[1,[2,3]]", "{a:[1,{b:2}]}", "'[a, {'", "a:b", "${b}"])
def test_one_value_is_taken(value: str) -> None:
    check_value(f"key={value}", "collect", UNKNOWN)


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("collect.num_envs=[1,2", r"the \[ is not closed\. .* such as collect\.num_envs=8\."),
        ("scenario.cameras.front.pos=1.2,0,0.8", r"write scenario\.cameras\.front\.pos=\[1\.2,0,0\.8\]\.$"),
        ("cameras.front.pos=1.2, 0, 0.8", r"write cameras\.front\.pos=\[1\.2, 0, 0\.8\]\.$"),
        ("cameras=front,wrist", r"Write cameras=\[front,wrist\]\.$"),
        (
            "num_envs=${nowhere}",
            r"value of another key, and there is none of this name\. .* write \\\$\{ inst",
        ),
    ],
)
def test_a_command_says_so_of_the_word_as_it_was_typed(word: str, said: str) -> None:
    with pytest.raises(ConfigError, match=f"^'.*{re.escape(word)}' .*{said}"):
        compose("collect", [word])


def test_a_sweep_says_so_before_anything_runs() -> None:
    with pytest.raises(ConfigError, match=r"^'image_size=\[64,128' cannot be read: the \[ is not closed"):
        plan(["image_size=[64,128"])
    with pytest.raises(
        ConfigError, match=r"front\.pos: input should be a list in brackets, .* given 1\.2\.$"
    ):
        plan(["cameras.front.pos=1.2,0,0.8"])

"""Files of kept values."""

import re

import pytest

from envs.core.errors import ConfigError
from envs.core.json_file import read_kept


def read(path):
    return read_kept(path, lambda values: values["a"], "has no a", "Remove it.")


def test_a_file_is_parsed_and_none_is_there_without_it(tmp_path):
    path = tmp_path / "kept.json"
    assert read(path) is None
    path.write_text('{"a": [1, "ä"]}', encoding="utf-8")
    assert read(path) == [1, "ä"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "JSONDecodeError: Expecting property name"),
        ("{}", "KeyError: 'a'"),
        ("[]", "TypeError: list indices"),
        (b"\xff", "UnicodeDecodeError"),
    ],
)
def test_a_damaged_file_is_named_with_what_it_lacks(tmp_path, text, said):
    path = tmp_path / "kept.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ConfigError, match=rf"kept\.json has no a \({re.escape(said)}.*\)\. Remove it\."):
        read(path)

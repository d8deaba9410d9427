"""Frozen data as JSON values."""

from dataclasses import dataclass
from pathlib import Path

from envs.core.json_values import flat, to_json_values


@dataclass(frozen=True)
class Part:
    size: tuple[int, int]


@dataclass(frozen=True)
class Whole:
    parts: tuple[Part, ...]
    by_name: dict[int, Part]
    folder: Path
    absent: None = None


def test_data_of_any_depth_is_plain():
    value = Whole((Part((1, 2)),), {3: Part((4, 5))}, Path("a") / "b")
    assert to_json_values(value) == {
        "parts": [{"size": [1, 2]}],
        "by_name": {"3": {"size": [4, 5]}},
        "folder": "a/b",
        "absent": None,
    }


def test_nested_values_have_dotted_keys_and_a_leaf_stays_whole():
    nested = {"a": {"b": {"c": 1}, "d": {}}, "e": [2]}
    assert flat(nested) == {"a.b.c": 1, "e": [2]}
    assert flat(nested, "x.") == {"x.a.b.c": 1, "x.e": [2]}
    assert flat(nested, leaves=("a.b", "a.d")) == {"a.b": {"c": 1}, "a.d": {}, "e": [2]}

"""Frozen data as plain values."""

from dataclasses import dataclass
from pathlib import Path

from envs.core.plain_values import plain


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
    assert plain(value) == {
        "parts": [{"size": [1, 2]}],
        "by_name": {"3": {"size": [4, 5]}},
        "folder": "a/b",
        "absent": None,
    }

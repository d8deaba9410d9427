"""Names and words of the 45 tasks that have no class of their own; nothing heavy is imported."""

import json
from pathlib import Path

PREFIX = "metaworld/"

WORDS: dict[str, tuple[str, ...]] = {
    name: tuple(words)
    for name, words in json.loads(Path(__file__).with_name("words.json").read_text(encoding="utf-8")).items()
}
"""Meta-World's name, without its version, to instructions."""

VERSION = "-v3"
"""Suffix that Meta-World adds to each of these names."""

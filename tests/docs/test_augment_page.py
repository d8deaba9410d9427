"""The page of generated demonstrations: its table of keys."""

import re
from dataclasses import asdict
from pathlib import Path

from roboverse_learn.data.augmentation.config import AugmentConfig

PAGE = Path(__file__).parents[2] / "docs/howto/augment.md"


def test_each_key_is_shown_with_its_default():
    shown = dict(re.findall(r"`augment\.(\w+)=([^`]+)`", PAGE.read_text(encoding="utf-8")))
    defaults = asdict(AugmentConfig())
    assert shown.keys() == defaults.keys()
    assert shown == {name: str(value).lower() for name, value in defaults.items()}

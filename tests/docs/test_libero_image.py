"""The image of LIBERO's scenes."""

import numpy as np
import pytest

from docs.generate import libero_image
from docs.generate.libero_image import COLUMNS, PIXELS, sheet, shown
from envs.core.errors import ConfigError
from envs.experts.counts import ExpertCount
from envs.tasks.libero.catalogue import entries


def test_a_task_of_each_scene_that_the_expert_solves_is_shown():
    names = shown()
    scenes = [entries()[name].scene_name for name in names]
    assert len(set(scenes)) == len(scenes) == len({entry.scene_name for entry in entries().values()}) == 23


def test_words_choose_tasks_that_count(monkeypatch):
    first = next(iter(entries()))
    counts = {name: ExpertCount(20, 0.8 if name == first else 0.75, 90.0) for name in entries()}
    monkeypatch.setattr(libero_image, "read_counts", lambda: counts)
    assert shown(["libero/", "bowl"]) == [first]
    with pytest.raises(ConfigError, match="has the words libero/ and fridge in its name"):
        shown(["libero/", "fridge"])


def test_strips_are_side_by_side_in_rows():
    strips = [np.full((256, 512, 3), 10 * (place + 1), np.uint8) for place in range(COLUMNS + 1)]
    image = np.asarray(sheet(strips))
    assert image.shape == (2 * PIXELS, 2 * PIXELS * COLUMNS, 3)
    assert (image[:PIXELS, : 2 * PIXELS] == 10).all() and (
        image[:PIXELS, -2 * PIXELS :] == 10 * COLUMNS
    ).all()
    assert (image[PIXELS:, : 2 * PIXELS] == 50).all() and (image[PIXELS:, 2 * PIXELS :] == 255).all()

"""Where objects stand: circles that keep a gap."""

import numpy as np
import pytest

from envs.tasks.grasp_language.scene import draw_places

RADII = [0.045, 0.04, 0.06, 0.05, 0.035]


def gaps(places, radii):
    away = np.linalg.norm(places[:, None] - places, axis=-1) - np.add.outer(radii, radii)
    return away[np.triu_indices(len(radii), 1)]


@pytest.mark.parametrize("seed", range(5))
def test_circles_keep_their_gap_inside_the_rectangle(seed):
    places = draw_places(np.random.default_rng(seed), RADII, (0.16, 0.3), 0.02)
    assert (np.abs(places) <= (0.16, 0.3)).all()
    assert gaps(places, RADII).min() >= 0.02


def test_a_crowd_ends_with_smaller_gaps():
    places = draw_places(np.random.default_rng(0), [0.1] * 8, (0.2, 0.2), 0.05)
    assert (np.abs(places) <= 0.2).all() and gaps(places, [0.1] * 8).min() < 0.05
    assert len(np.unique(places, axis=0)) == 8
